"""The interface of vision-language models: preprocessing, embeddings, the last maps of images and their gradient.

Grounding reads a model through it: `grad_cam` finds phrases in the last maps, whatever made them.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor


class TracedMaps(NamedTuple):
    """The last maps of images, and what a model makes of them.

    Attributes:
        maps: float32 (N, C, h, w), a leaf of the graph.
        embeddings: float32 (N, D), of length 1; their gradient reaches the maps. Attention over the cells and the
            length before it was made 1 count as constants where the model can hold them fixed.
    """

    maps: Tensor
    embeddings: Tensor


class VisionLanguageModel(Protocol):
    """A pretrained model of images and texts, which its embeddings compare.

    Attributes:
        image_size: Height and width of its images, in pixels.
        dimension: D, of its embeddings.
    """

    image_size: int
    dimension: int

    @property
    def device(self) -> torch.device:
        """Device of the weights."""

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's, uint8 (H, W, 3)."""

    def embed_images(self, images: Tensor) -> Tensor:
        """Returns the embeddings, float32 (N, D) of length 1, of images uint8 (N, H, W, 3)."""

    def embed_texts(self, texts: Sequence[str]) -> Tensor:
        """Returns the embeddings, float32 (K, D) of length 1, of texts."""

    def truncated(self, texts: Sequence[str]) -> npt.NDArray[np.bool_]:
        """Returns whether each text is longer than the model reads, bool (K,)."""

    def last_maps(self, images: Tensor) -> Tensor:
        """Returns the maps that Grad-CAM reads, float32 (N, C, h, w), of images uint8 (N, H, W, 3)."""

    def traced_maps(self, images: Tensor) -> TracedMaps:
        """Returns these maps, and the embeddings as a function of them."""

    def channel_weights(self, directions: Tensor) -> Tensor | None:
        """Returns Grad-CAM's channel weights in closed form, but for a factor: float32 (P, C) of directions (P, D).

        None where there is no closed form.
        """
