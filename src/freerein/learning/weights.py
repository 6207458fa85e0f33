"""First weights, drawn from a generator that is passed in, and a name for any weights."""

import hashlib
from typing import Protocol, runtime_checkable

import torch
from torch import nn

from freerein.learning import tensor_files


@runtime_checkable
class CustomInitialisation(Protocol):
    """A layer with a rule of its own for its first weights."""

    def initialise(self, generator: torch.Generator) -> None:
        """Overwrites the weights that are the layer's own, not its children's."""


def initialise(network: nn.Module, *, generator: torch.Generator) -> None:
    """Overwrites every weight of a network with a fresh draw: uniform in ±1/sqrt(fan-in), as torch's layers default to.

    An embedding's fan-in is its number of features: unlike torch's, so that it is as large as what it is added to.

    Args:
        network: Made of Linear, Conv2d, LSTM, Embedding, LayerNorm, BatchNorm2d and layers with a rule of their own.
        generator: On the CPU.

    Raises:
        TypeError: The network has weights in another kind of layer.
    """
    for layer in network.modules():
        if isinstance(layer, CustomInitialisation):
            layer.initialise(generator)
        elif isinstance(layer, nn.LayerNorm | nn.BatchNorm2d):
            layer.reset_parameters()
        elif isinstance(layer, nn.LSTM):
            _draw_uniform(layer, layer.hidden_size**-0.5, generator)
        elif isinstance(layer, nn.Linear | nn.Conv2d | nn.Embedding):
            _draw_uniform(layer, layer.weight[0].numel() ** -0.5, generator)
        elif any(True for _ in layer.parameters(recurse=False)):
            raise TypeError(f"There is no rule for the first weights of {type(layer).__name__}.")


def sha256(network: nn.Module) -> str:
    """Returns the sha256, in hexadecimal, over the names, shapes and bits of a network's weights and buffers."""
    return hashlib.sha256(tensor_files.dump(network.state_dict())).hexdigest()


def _draw_uniform(layer: nn.Module, bound: float, generator: torch.Generator) -> None:
    for parameter in layer.parameters(recurse=False):
        nn.init.uniform_(parameter, -bound, bound, generator=generator)
