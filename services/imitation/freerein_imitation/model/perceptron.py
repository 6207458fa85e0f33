"""A multilayer perceptron."""

from itertools import pairwise

from torch import nn


def perceptron(inputs: int, outputs: int, *, hidden_size: int, depth: int) -> nn.Sequential:
    """Returns `depth` hidden layers with ReLU, and a linear output layer: float32 (..., inputs) to (..., outputs)."""
    sizes = [inputs, *[hidden_size] * depth]
    hidden = [layer for each in pairwise(sizes) for layer in (nn.Linear(*each), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(hidden_size, outputs))
