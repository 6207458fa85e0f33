"""Protocols of the two kinds of models: numpy in, numpy out."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.goal_text import Grammar
from freerein.types.common import ModelRef
from freerein_reward.model import ImageEmbeddings, PhraseLocations


@runtime_checkable
class RewardModel(Protocol):
    """A trained reward model: embeds images and texts, and compares them.

    Attributes:
        cameras: Cameras that it expects; one empty name for any image.
        aspects: Height over width of the frames of the fit, by camera; a camera that is not there may have any.
        grammar: Reads goal texts.
    """

    cameras: tuple[str, ...]
    aspects: Mapping[str, float]
    grammar: Grammar

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's input, uint8 (H, W, 3)."""

    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        """Returns what the model keeps of frames by camera, uint8 (N, H, W, 3)."""

    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns embeddings, float32 (K, D), and whether each text was truncated, bool (K,)."""

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns similarities in [-1, 1], float32 (N, K), of vectors of `ImageEmbeddings`, and of K texts."""

    def in_distribution(
        self, distances: npt.NDArray[np.float32], similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Returns how much each answer is like held-out ones, float32 (N,), or (0,) for a model without the score.

        Args:
            distances: Those of `ImageEmbeddings`, float32 (N,).
            similarities: Of each image with each of K rival texts, float32 (N, K).
        """


@runtime_checkable
class GroundingModel(Protocol):
    """A trained model that locates noun phrases in images; it may be a reward model, too.

    Attributes:
        grammar: Knows the words that the model was trained on.
    """

    grammar: Grammar

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's input, uint8 (H, W, 3)."""

    def locate(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> PhraseLocations:
        """Returns the locations of phrases in images uint8 (N, H, W, 3), and how well it knows them."""


def wrong_kind(ref: ModelRef, *, got: str, expected: str) -> InvalidInput:
    """Returns the error of a request that names a model of the other kind."""
    return InvalidInput(
        f"`model` must name a {expected} model; {ref.name} {ref.version} is a {got} model.",
        field="model",
        hint="Leave it out for the active one.",
    )
