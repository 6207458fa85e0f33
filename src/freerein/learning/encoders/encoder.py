"""The protocols of an image encoder, and of a class of them."""

from typing import Protocol

import torch
from torch import Tensor, nn


class Encoder(Protocol):
    """Encoder of one camera; it is a torch module, too."""

    def fit_normalisation(self, frames: Tensor, *, generator: torch.Generator) -> None:
        """Sets what is not trained from training frames, uint8 (N, H, W, C); the generator is on the CPU."""

    def __call__(self, frames: Tensor) -> Tensor:
        """Returns features, float32 (N, D), of frames uint8 (N, H, W, C)."""


class EncoderClass(Protocol):
    """Class of encoders of one camera.

    Attributes:
        min_features: Fewest features of a camera.
    """

    min_features: int

    def __call__(self, *, height: int, width: int, channels: int, features: int) -> nn.Module:
        """Returns an `Encoder` of frames of a size in pixels, with 1 or 3 channels, to `features` numbers."""
