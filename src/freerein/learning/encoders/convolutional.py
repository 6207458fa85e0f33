"""A plain convolutional encoder, for cameras that move: it compares frames with no mean image."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

_CHANNELS = 32
_LAYERS = 4
_FRAMES_AT_ONCE = 32
"""Few enough that what layers hand on stays in the cache of a processor: a third less time than 384 at once."""


class StandardisedFrames(nn.Module):
    """Base of networks that see frames with the mean of each channel subtracted, divided by one standard deviation."""

    mean: Tensor
    std: Tensor

    def __init__(self, *, channels: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(channels, 1, 1))
        self.register_buffer("std", torch.ones(()))

    @torch.no_grad()
    def fit_normalisation(self, frames: Tensor, *, generator: torch.Generator | None = None) -> None:
        """Sets each channel's mean and the standard deviation of pixels from training frames, uint8 (N, H, W, C).

        Nothing is drawn from the generator.
        """
        pixels = frames.permute(0, 3, 1, 2).float()  # (N, C, H, W)
        self.mean.copy_(pixels.mean(dim=(0, 2, 3))[:, None, None])
        self.std.copy_((pixels - self.mean).std().clamp(min=1.0))

    def standardised(self, frames: Tensor) -> Tensor:
        """Returns float32 (N, C, H, W) of frames uint8 (N, H, W, C)."""
        standardised: Tensor = (frames.permute(0, 3, 1, 2).float() - self.mean) / self.std
        return standardised


class ConvolutionalEncoder(StandardisedFrames):
    """Four 3 x 3 convolutions of stride 2, as in the curiosity module of Pathak et al. (2017), and a dense layer.

    Frames have height and width in pixels, and 1 or 3 channels.
    """

    min_features = 1

    def __init__(self, *, height: int, width: int, channels: int, features: int) -> None:
        super().__init__(channels=channels)
        inputs = [channels, *[_CHANNELS] * (_LAYERS - 1)]
        self.layers = nn.ModuleList(nn.Conv2d(each, _CHANNELS, kernel_size=3, stride=2, padding=1) for each in inputs)
        cells = math.prod(math.ceil(side / 2**_LAYERS) for side in (height, width))
        self.head = nn.Linear(_CHANNELS * cells, features)
        self.norm = nn.LayerNorm(features)

    def forward(self, frames: Tensor) -> Tensor:
        """Returns non-negative features, float32 (N, features), of frames uint8 (N, H, W, C)."""
        is_graph = torch.compiler.is_exporting()  # which cannot loop over frames
        parts = (frames,) if is_graph else torch.split(frames, _FRAMES_AT_ONCE)
        return torch.cat([self._encode(part) for part in parts])

    def _encode(self, frames: Tensor) -> Tensor:
        x = self.standardised(frames)  # (N, C, H, W)
        for layer in self.layers:
            x = functional.elu(layer(x), inplace=True)  # (N, channels, rows, columns), half as many each time
        return functional.relu(self.norm(self.head(x.flatten(start_dim=1))))
