"""The two kinds of models, as the core knows them: numpy in, numpy out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.types.common import ModelRef
from freerein_reward.model import Grounds


class Preprocess(Protocol):
    """Makes any image into what a model sees."""

    def __call__(self, image: npt.NDArray[np.uint8], /) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as uint8 (H, W, 3)."""


@runtime_checkable
class RewardModel(Protocol):
    """A trained reward model: images and texts become comparable.

    Attributes:
        cameras: Whose frames it sees; one empty name for any image.
    """

    cameras: tuple[str, ...]

    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> npt.NDArray[np.float32]:
        """Returns the embeddings float32 (N, D), of length 1, of frames by camera, uint8 (N, H, W, 3)."""

    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns the embeddings float32 (K, D), of length 1, and whether each text was cut, bool (K,)."""

    def unknown_words(self, text: str) -> int:
        """Returns how many words of a text it has never seen."""


@runtime_checkable
class GroundingModel(Protocol):
    """A trained grounding model: it finds things that are named."""

    def ground(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> Grounds:
        """Returns where the phrases are in images uint8 (N, H, W, 3)."""


Model: TypeAlias = RewardModel | GroundingModel


@dataclass(frozen=True, eq=False)
class Loaded:
    """A model in memory.

    Attributes:
        model: The model.
        preprocess: Makes images into what it sees.
    """

    model: Model
    preprocess: Preprocess


def wrong_kind(ref: ModelRef, *, is_a: str, wanted: str) -> InvalidInput:
    """Returns the error of a request that names a model of the other kind."""
    return InvalidInput(
        f"`model` must name a {wanted} model; {ref.name} {ref.version} is a {is_a} model.",
        field="model",
        hint="Leave it out for the active one.",
    )
