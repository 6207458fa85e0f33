"""One encoder per camera."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import cast

import torch
from torch import Tensor, nn

from freerein.learning.encoders.encoder import Encoder, EncoderClass
from freerein.learning.encoders.exposure import ExposureNormalisation
from freerein.types.common import Camera

FrameTensors = Mapping[str, Tensor]
"""By camera: uint8 (N, H, W, C)."""

_COMPARED_FRAMES = 32
_LEAST_DIFFERENCE = 1e-6


class CameraEncoders(nn.Module):
    """Encodes frames of one or several cameras, each by an encoder of its own, and concatenates the features.

    Args:
        encoder: Class of the encoders: a value of `ENCODERS`.
        cameras: The cameras.
        features: Number of features per camera.
        normalise_exposure: Whether frames are made as bright as the training frames first.

    Attributes:
        size: D, the number of features of all cameras.
    """

    def __init__(
        self, encoder: EncoderClass, cameras: Sequence[Camera], *, features: int, normalise_exposure: bool = False
    ) -> None:
        super().__init__()
        self.size = features * len(cameras)
        self._names = tuple(camera.name for camera in cameras)
        self._compared: dict[str, Tensor] = {}
        self.encoders = nn.ModuleList(
            encoder(height=camera.height, width=camera.width, channels=camera.channels, features=features)
            for camera in cameras
        )
        self.exposures = nn.ModuleList(
            ExposureNormalisation(height=camera.height, width=camera.width, channels=camera.channels)
            for camera in cameras
            if normalise_exposure
        )

    @torch.no_grad()
    def fit_normalisation(self, frames: FrameTensors, *, generator: torch.Generator) -> None:
        """Sets what is not trained, such as mean images, from training frames; draws from a generator on the CPU."""
        for name, encoder in self._by_camera():
            encoder.fit_normalisation(frames[name], generator=generator)
        for name, exposure in zip(self._names, self.exposures, strict=False):
            cast(ExposureNormalisation, exposure).fit(frames[name])
        self._compared = {name: each[:: -(-len(each) // _COMPARED_FRAMES)].clone() for name, each in frames.items()}

    @torch.no_grad()
    def dead_cameras(self) -> list[str]:
        """Returns the cameras whose training frames, of `fit_normalisation`, differ while their features do not.

        Layers that are zero for all frames have no gradient, and never come back.
        """
        compared = ((name, encoder, self._compared.get(name)) for name, encoder in self._by_camera())
        return [name for name, encoder, frames in compared if frames is not None and self._is_dead(encoder, frames)]

    def forward(self, frames: FrameTensors) -> Tensor:
        """Returns features, float32 (N, D), of frames by camera, uint8 (N, H, W, C)."""
        seen = dict(frames)
        for name, exposure in zip(self._names, self.exposures, strict=False):
            seen[name] = exposure(seen[name])
        return torch.cat([encoder(seen[name]) for name, encoder in self._by_camera()], dim=1)

    def _is_dead(self, encoder: Encoder, frames: Tensor) -> bool:
        if bool((frames == frames[0]).all()):
            return False
        was_training = self.training
        self.eval()  # statistics of batches, if any, are those of training
        device = next(chain(self.parameters(), self.buffers())).device
        features = encoder(frames.to(device))  # (N, features)
        self.train(was_training)
        return bool((features - features[0]).abs().max() < _LEAST_DIFFERENCE)

    def _by_camera(self) -> Iterable[tuple[str, Encoder]]:
        return zip(self._names, cast(Iterable[Encoder], self.encoders), strict=True)
