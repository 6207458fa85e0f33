"""A trained network as a folder.

<folder>/model.safetensors   weights
         card.json           model card: `spec`, the network's architecture; data, configuration, figures
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

import torch
from torch import nn
from torch.overrides import TorchFunctionMode

from freerein.atomic_files import write_atomic
from freerein.config import C, parse
from freerein.errors import FailedPrecondition, InvalidInput, quoted
from freerein.learning import tensor_files
from freerein.learning.checkpoints import JSON

_MAX_CARD_BYTES = 1 << 20


class ModelFileNames(NamedTuple):
    """File names of a model folder."""

    weights: str = "model.safetensors"
    card: str = "card.json"


MODEL = ModelFileNames()


class HasSpec(Protocol):
    """A network whose `spec`, a frozen dataclass, defines its architecture."""

    @property
    def spec(self) -> Any:
        """The architecture."""

    def state_dict(self) -> Mapping[str, torch.Tensor]:
        """Returns the weights."""


N = TypeVar("N", bound=nn.Module)


def save_model(network: HasSpec, folder: Path, *, card: Mapping[str, JSON], names: ModelFileNames = MODEL) -> None:
    """Writes a trained network as a folder that `load_model` reads; `card` holds the entries beside `spec`."""
    write_atomic(folder / names.weights, tensor_files.dump(dict(network.state_dict())))
    document = {**card, "spec": asdict(network.spec)}
    write_atomic(folder / names.card, json.dumps(document, indent=2, allow_nan=False).encode() + b"\n")


def load_model(
    folder: Path, spec_class: type[C], make: Callable[[C], N], *, device: str, names: ModelFileNames = MODEL
) -> N:
    """Returns the network in a folder, in evaluation mode.

    Args:
        folder: Written by `save_model`; read as untrusted.
        spec_class: Dataclass of the card's `spec`.
        make: Constructs the network of a spec.
        device: `auto`, `cpu` or `cuda:N`.
        names: File names.

    Raises:
        InvalidInput: A file is missing or malformed.
    """
    spec = _spec(read_card(folder, names=names), spec_class)
    try:
        with _WithoutInitialisation():
            network = make(spec)
        weights = tensor_files.parse((folder / names.weights).read_bytes())
        own = network.state_dict()
        if any(name in own and tensor.dtype != own[name].dtype for name, tensor in weights.items()):
            raise RuntimeError("another type")
        network.load_state_dict(weights, assign=True)
    except (OSError, RuntimeError) as error:
        raise InvalidInput(
            "A model's weights must have the names, shapes and types that its card describes; loading them failed: "
            f"{quoted(str(error))}.",
            hint="Fit the model again, or restore its folder from a copy.",
        ) from error
    return network.to(choose_device(device)).eval()


def read_card(folder: Path, *, names: ModelFileNames = MODEL) -> dict[str, Any]:
    """Returns the model card of a folder. Raises InvalidInput when it is missing, or not a JSON object."""
    path = folder / names.card
    try:
        if path.stat().st_size > _MAX_CARD_BYTES:
            raise ValueError("too large")
        return dict(json.loads(path.read_bytes()))
    except (OSError, ValueError, RecursionError, TypeError) as error:
        raise _no_card(error) from error


def choose_device(device: str) -> torch.device:
    """Returns the device of a name; `auto` is CUDA when available, else the CPU.

    Raises FailedPrecondition when this machine has no such device, or its torch cannot use it.
    """
    chosen = torch.device(("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device)
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if chosen.type == "cuda" and (chosen.index or 0) >= count:
        found = f"cpu and cuda:0 to cuda:{count - 1}" if count else "cpu alone, for torch finds no CUDA device"
        raise FailedPrecondition(
            f"FREEREIN_DEVICE must be a device of this machine, which has {found}; got {chosen}.",
            hint="Set it to auto or cpu, or install a CUDA driver and a torch for it; `freerein doctor` lists devices.",
        )
    return chosen


class _WithoutInitialisation(TorchFunctionMode):
    """Leaves new weights as they are, untouched memory: those of a file take their place.

    The device `meta` would do as much, but its Python kernels import torch's compiler: a second, and 70 MB.
    """

    def __torch_function__(
        self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        if getattr(func, "__module__", "") == nn.init.__name__:
            return kwargs["tensor"] if kwargs else args[0]
        return func(*args, **(kwargs or {}))


def _spec(card: Mapping[str, Any], spec_class: type[C]) -> C:
    try:
        return parse(spec_class, card["spec"])
    except (ValueError, KeyError, TypeError) as error:
        raise _no_card(error) from error


def _no_card(error: Exception) -> InvalidInput:
    return InvalidInput(
        f"A model's card must be JSON of at most {_MAX_CARD_BYTES} bytes with a `spec`; got {quoted(repr(error))}.",
        hint="Fit the model again, or restore its folder from a copy.",
    )
