"""Weight initialisation from a generator, and a hash of a network's weights."""

import hashlib
from typing import Protocol, runtime_checkable

import torch
from torch import nn

from freerein.learning import tensor_files


@runtime_checkable
class CustomInitialisation(Protocol):
    """A layer with an initialisation of its own."""

    def initialise(self, generator: torch.Generator) -> None:
        """Initialises the layer's own parameters, not its children's."""


def initialise(network: nn.Module, *, generator: torch.Generator) -> None:
    """Initialises every parameter but frozen ones: uniform in ±1/sqrt(fan-in), as torch's layers do by default.

    An embedding's fan-in is its number of features, so that embeddings are as large as what they are added to.

    Args:
        network: Made of Linear, Conv2d, LSTM, Embedding, LayerNorm, BatchNorm2d and `CustomInitialisation` layers;
            others may have frozen parameters only.
        generator: Source of all randomness, on the CPU.

    Raises:
        TypeError: The network has parameters in another kind of layer.
    """
    for layer in network.modules():
        if _is_frozen(layer):
            continue
        if isinstance(layer, CustomInitialisation):
            layer.initialise(generator)
        elif isinstance(layer, nn.LayerNorm | nn.BatchNorm2d):
            layer.reset_parameters()
        elif isinstance(layer, nn.LSTM):
            _initialise_uniform(layer, layer.hidden_size**-0.5, generator)
        elif isinstance(layer, nn.Linear | nn.Conv2d | nn.Embedding):
            _initialise_uniform(layer, layer.weight[0].numel() ** -0.5, generator)
        elif any(True for _ in layer.parameters(recurse=False)):
            raise TypeError(f"{type(layer).__name__} has parameters and no initialisation rule.")


def sha256(network: nn.Module) -> str:
    """Returns the hexadecimal sha256 over the names, shapes and bits of a network's parameters and buffers."""
    return hashlib.sha256(tensor_files.dump(network.state_dict())).hexdigest()


def _is_frozen(layer: nn.Module) -> bool:
    """Returns whether a layer has parameters of its own, none of which is trained."""
    trained = [parameter.requires_grad for parameter in layer.parameters(recurse=False)]
    return bool(trained) and not any(trained)


def _initialise_uniform(layer: nn.Module, bound: float, generator: torch.Generator) -> None:
    for parameter in layer.parameters(recurse=False):
        nn.init.uniform_(parameter, -bound, bound, generator=generator)
