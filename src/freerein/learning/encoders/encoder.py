"""What a class of image encoders is."""

from typing import Protocol

from torch import nn


class EncoderClass(Protocol):
    """Class of encoders of one camera; an encoder is a torch module, called with frames uint8 (N, H, W, C).

    It also has `fit_normalisation(frames, *, generator)`, which sets what is not trained from training frames.

    Attributes:
        is_trained: Whether it has weights to train; else its parameters are frozen, and frames may be encoded once,
            before training.
        has_colour_moments: Whether features are `colour_codebook.MOMENTS` for each of as many colours as fit, then
            zeros.
        min_features: Fewest features of a camera.
    """

    is_trained: bool
    has_colour_moments: bool
    min_features: int

    def __call__(self, *, height: int, width: int, channels: int, features: int) -> nn.Module:
        """Returns an encoder of frames of a size in pixels, with 1 or 3 channels, to `features` numbers."""
