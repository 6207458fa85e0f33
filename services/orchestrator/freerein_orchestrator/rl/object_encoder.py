"""The image encoder of a stored reward model, for the eye of a policy."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import model_files, tensor_files
from freerein.learning.actor_critic.eye import EyeSpec
from freerein.learning.config import parse
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.types.common import Camera

_PREFIX = "image."
_HINT = "Choose a reward model that was fitted to frames of this camera, or the encoder `spatial`."


@dataclass(frozen=True, eq=False)
class ObjectEncoder:
    """An encoder that locates the two objects of a goal.

    Attributes:
        spec: What the eye looks for.
        weights: By name.
    """

    spec: EyeSpec
    weights: Mapping[str, Tensor]


def load_object_encoder(folder: Path, *, goal_caption: str, camera: Camera) -> ObjectEncoder:
    """Returns the image encoder of a reward model.

    Args:
        folder: The model's; read as untrusted.
        goal_caption: The goal text as the model reads it: two of its noun phrases and a relation.
        camera: The camera of the frames, and their size.

    Raises:
        InvalidInput: The model is of another camera or frame size, or names no two objects; a file is malformed.
    """
    card: Any = model_files.read_card(folder).get("spec")
    try:
        phrases = [str(phrase) for phrase in card["phrases"]]
        sizes = {name: card[name] for name in ("width", "depth", "hidden_size", "embedding_dim")}
        seen = (list(card["cameras"]), card["image_size"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(
            "An eye needs the card of a reward model; this one is of another kind.", hint=_HINT
        ) from error
    if seen != ([camera.name], camera.height) or camera.height != camera.width:
        raise InvalidInput(
            f"The eye's reward model must see {camera.name} at {camera.height} x {camera.width}; this one does not.",
            field="config.reward_model",
            hint=_HINT,
        )
    first, second = _pair(phrases, goal_caption)
    image = parse(ClipImageSpec, {"phrases": len(phrases), **sizes})
    tensors = tensor_files.parse((folder / model_files.MODEL.weights).read_bytes())
    weights = {name.removeprefix(_PREFIX): each for name, each in tensors.items() if name.startswith(_PREFIX)}
    return ObjectEncoder(EyeSpec(image, first, second), weights)


def _pair(phrases: Sequence[str], caption: str) -> tuple[int, int]:
    """Returns the numbers of the two phrases that a caption names, in its order."""
    named = sorted((caption.index(phrase), number) for number, phrase in enumerate(phrases) if phrase in caption)
    if len(named) != 2:
        raise InvalidInput(
            f"The goal text must name two objects that the reward model knows; it names {len(named)}.",
            field="config.goal_text",
            hint="Relate two of its noun phrases, or choose the encoder `spatial`.",
        )
    (_, first), (_, second) = named
    return first, second
