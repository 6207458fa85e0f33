"""The teachers' object encoder as the image encoder of their student."""

import torch
from torch import Tensor, nn

from freerein.learning.actor_critic.shared_object_encoder import SharedObjectEncoder, SharedObjectEncoderSpec
from freerein.learning.encoders import FrameTensors
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.types.common import Camera


class TeacherObjectEncoder(nn.Module):
    """Sees one RGB frame of one camera; frozen.

    Args:
        image: Sizes of the object encoder's image encoder.
        phrases: Noun phrases that it locates.
        camera: The camera.
        action_size: Numbers per action.

    Attributes:
        shared: The object encoder.
        size: Numbers per frame.
    """

    def __init__(self, image: ClipImageSpec, phrases: tuple[str, ...], *, camera: Camera, action_size: int) -> None:
        super().__init__()
        self.shared = SharedObjectEncoder(
            SharedObjectEncoderSpec(image, phrases, camera.height, camera.width, action_size)
        )
        self.size = self.shared.size
        self._camera = camera.name

    def fit_normalisation(self, _frames: FrameTensors, *, generator: torch.Generator) -> None:
        """Does nothing: the object encoder is not trained."""

    def forward(self, frames: FrameTensors) -> Tensor:
        """Returns encodings, float32 (N, size), of frames by camera, uint8 (N, H, W, 3)."""
        seen: Tensor = self.shared(frames[self._camera])
        return seen
