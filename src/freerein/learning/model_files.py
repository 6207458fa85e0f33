"""A trained network as a folder: its weights, and a card that says what it is.

<folder>/model.safetensors   weights
         card.json           `spec`: what the network is; and what it was trained on, how, with which figures
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch
from torch import nn

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput
from freerein.learning import tensor_files
from freerein.learning.checkpoints import JSON
from freerein.learning.config import C, parse

WEIGHTS, CARD = "model.safetensors", "card.json"
_MAX_CARD_BYTES = 1 << 20


@dataclass(frozen=True)
class ModelFileNames:
    """What the two files are called.

    Attributes:
        weights: The file of the weights.
        card: The card.
    """

    weights: str = WEIGHTS
    card: str = CARD


MODEL = ModelFileNames()


class HasSpec(Protocol):
    """A network that knows what it is: `spec`, a frozen dataclass from which another like it can be made."""

    @property
    def spec(self) -> Any:
        """What the network is."""

    def state_dict(self) -> Mapping[str, torch.Tensor]:
        """Returns the weights."""


N = TypeVar("N", bound=nn.Module)


def save_model(network: HasSpec, folder: Path, *, card: Mapping[str, JSON], names: ModelFileNames = MODEL) -> None:
    """Writes a trained network as a folder that `load` reads.

    Args:
        network: Trained.
        folder: Made when missing; its files are written over.
        card: What to tell about the model beside its `spec`: kind, configuration, seed, data, figures.
        names: What the files are called.
    """
    write_atomic(folder / names.weights, tensor_files.dump(dict(network.state_dict())))
    document = {**card, "spec": asdict(network.spec)}
    write_atomic(folder / names.card, json.dumps(document, indent=2, allow_nan=False).encode() + b"\n")


def load_model(
    folder: Path, spec_class: type[C], make: Callable[[C], N], *, device: str, names: ModelFileNames = MODEL
) -> N:
    """Returns the network in a folder, in evaluation mode.

    Args:
        folder: Written by `export`; read as untrusted.
        spec_class: The dataclass of its spec.
        make: Returns a network of a spec; its weights come from the file.
        device: `auto`, `cpu` or `cuda:N`.
        names: What the files are called.

    Raises:
        InvalidInput: A file is missing, or is not what `export` writes.
    """
    spec = _spec(read_card(folder, names=names), spec_class)
    with torch.device("meta"):  # no weights are drawn
        network = make(spec)
    try:
        weights = tensor_files.parse((folder / names.weights).read_bytes())
        own = network.state_dict()
        if any(name in own and tensor.dtype != own[name].dtype for name, tensor in weights.items()):
            raise RuntimeError("another type")
        network.load_state_dict(weights, assign=True)
    except (OSError, RuntimeError) as error:
        raise InvalidInput(
            "A model's weights must be those that its card describes; some are missing or have another shape or type.",
            hint="Fit the model again, or restore its folder from a copy.",
        ) from error
    return network.to(choose_device(device)).eval()


def read_card(folder: Path, *, names: ModelFileNames = MODEL) -> dict[str, Any]:
    """Returns what the card in a folder says.

    Raises:
        InvalidInput: There is none, or it is no JSON object.
    """
    path = folder / names.card
    try:
        if path.stat().st_size > _MAX_CARD_BYTES:
            raise ValueError("too large")
        return dict(json.loads(path.read_bytes()))
    except (OSError, ValueError, RecursionError, TypeError) as error:
        raise _no_card() from error


def choose_device(device: str) -> torch.device:
    """Returns the device of a name; `auto` is a CUDA device where there is one, else the CPU."""
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    return torch.device(chosen)


def _spec(card: Mapping[str, Any], spec_class: type[C]) -> C:
    try:
        return parse(spec_class, card["spec"])
    except (ValueError, KeyError, TypeError) as error:
        raise _no_card() from error


def _no_card() -> InvalidInput:
    return InvalidInput(
        f"A model's card must be JSON of at most {_MAX_CARD_BYTES} bytes with a `spec`; it is not.",
        hint="Fit the model again, or restore its folder from a copy.",
    )
