"""Early fusion of observations and goals: features of both images together, beside those of each alone."""

import math
from collections.abc import Iterable, Sequence
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.learning.encoders import FrameTensors
from freerein.learning.encoders.convolutional import StandardisedFrames
from freerein.types.common import Camera

_CHANNELS = 32
_FRAMES_AT_ONCE = 32
_PAIRS_AT_ONCE = 128
_STRIDE = 8
"""Pixels of a cell of the maps that are fused, each way."""


class PairEncoder(nn.Module):
    """Three convolutions, of which the second sees the maps of both images.

    It is linear in each, so its part of one image is computed once for all pairs with that image: the image's code.

    Attributes:
        code_size: Numbers of the code of a frame.
        size: Features of a pair.
    """

    def __init__(self, cameras: Sequence[Camera], *, features: int) -> None:
        super().__init__()
        self._names = tuple(camera.name for camera in cameras)
        self.encoders = nn.ModuleList(_CameraPairs(camera, features=features) for camera in cameras)
        self._sizes = [each.code_size for each in self._each()]
        self.code_size = sum(self._sizes)
        self.size = features * len(cameras)

    def fit_normalisation(self, frames: FrameTensors) -> None:
        """Sets means and standard deviations from training frames, uint8 (N, H, W, C) by camera."""
        for name, encoder in zip(self._names, self._each(), strict=True):
            encoder.fit_normalisation(frames[name])

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns codes, float32 (N, code_size), of frames uint8 (N, H, W, C) by camera."""
        encoded = (each.encode(frames[name]) for name, each in zip(self._names, self._each(), strict=True))
        return torch.cat([*encoded], dim=1)

    def forward(self, observations: Tensor, goals: Tensor) -> Tensor:
        """Returns features, float32 (..., size), of codes of observations and goals, float32 (..., code_size) each."""
        pairs = zip(*(torch.split(codes, self._sizes, dim=-1) for codes in (observations, goals)), strict=True)
        return torch.cat([each(*pair) for each, pair in zip(self._each(), pairs, strict=True)], dim=-1)

    def _each(self) -> Iterable["_CameraPairs"]:
        return cast(Iterable[_CameraPairs], self.encoders)


class _CameraPairs(StandardisedFrames):
    """The same of one camera. A code has the image's part as an observation, then that as a goal."""

    def __init__(self, camera: Camera, *, features: int) -> None:
        super().__init__(channels=camera.channels)
        self._map = (math.ceil(camera.height / _STRIDE), math.ceil(camera.width / _STRIDE), _CHANNELS)
        self.first = nn.Conv2d(camera.channels, _CHANNELS, kernel_size=5, stride=4, padding=2)
        self.as_observation, self.as_goal, self.fused = (_convolution() for _ in range(3))
        self.head = nn.Linear(_CHANNELS * math.prod(math.ceil(side / 2) for side in self._map[:2]), features)
        self.norm = nn.LayerNorm(features)
        self.code_size = 2 * math.prod(self._map)

    def encode(self, frames: Tensor) -> Tensor:
        """Returns codes, float32 (N, code_size), of frames uint8 (N, H, W, C)."""
        return torch.cat([self._encode(each) for each in _parts(frames, _FRAMES_AT_ONCE)])

    def forward(self, observations: Tensor, goals: Tensor) -> Tensor:
        """Returns features, float32 (..., features), of codes (..., code_size)."""
        half = self.code_size // 2
        maps = (observations[..., :half] + goals[..., half:]).reshape(-1, *self._map)
        features = torch.cat([self._fuse(each) for each in _parts(maps, _PAIRS_AT_ONCE)])
        return features.reshape(*observations.shape[:-1], -1)

    def _encode(self, frames: Tensor) -> Tensor:
        x = functional.elu(self.first(self.standardised(frames)), inplace=True)
        maps = (convolution(x) for convolution in (self.as_observation, self.as_goal))
        return torch.cat([each.permute(0, 2, 3, 1).flatten(start_dim=1) for each in maps], dim=1)

    def _fuse(self, maps: Tensor) -> Tensor:
        x = functional.elu(self.fused(functional.elu(maps.permute(0, 3, 1, 2))), inplace=True)
        return functional.relu(self.norm(self.head(x.flatten(start_dim=1))))


def _convolution() -> nn.Conv2d:
    return nn.Conv2d(_CHANNELS, _CHANNELS, kernel_size=3, stride=2, padding=1)


def _parts(values: Tensor, at_once: int) -> Sequence[Tensor]:
    """Returns parts that stay in the cache of a processor; a graph cannot loop over frames."""
    return (values,) if torch.compiler.is_exporting() else torch.split(values, at_once)
