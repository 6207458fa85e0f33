"""The goal recognizer of section 3.2: inputs, sizes and networks."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein.types.common import Camera
from freerein_imitation.model.torch_policy import PolicyNetwork

_MAX_LOGIT = 5.0  # of two equal images


class GoalRecognizer(nn.Module):
    """The goal recognizer of section 3.2 as a metric embedding: images a few actions apart are less than 1 apart.

    The dissertation leaves the network open. In a metric nothing is closer to a goal than the goal's own images.
    """

    def __init__(self, encoder: str, cameras: Sequence[Camera], *, embedding_size: int) -> None:
        super().__init__()
        self.encoder = CameraEncoders(ENCODERS[encoder], cameras, features=embedding_size)
        self.projection = nn.Linear(self.encoder.size, embedding_size, bias=False)

    def forward(self, frames: FrameTensors) -> Tensor:
        """Returns embeddings, float32 (N, embedding_size), of frames uint8 (N, H, W, C) by camera."""
        embedding: Tensor = self.projection(self.encoder(frames))
        return embedding


def proximity_logit(observation: Tensor, goal: Tensor) -> Tensor:
    """Returns the logit that two embeddings (..., embedding_size) are close, float32 (...)."""
    distance: Tensor = torch.linalg.vector_norm(observation - goal, dim=-1)
    return _MAX_LOGIT * (1 - distance)


@dataclass(frozen=True, kw_only=True)
class GoalRecognizerSpec(InputSpec):
    """Inputs and sizes of a goal recognizer.

    Attributes:
        encoder: Image encoder.
        embedding_size: Size of the embeddings, and image features per camera.

    Raises:
        InvalidInput: Cameras, actions or `embedding_size` are out of bounds; an encoder may need more features.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    embedding_size: int = bounded(64, least=2, most=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_embedding_size(self.encoder, self.embedding_size)


def check_embedding_size(encoder: str, embedding_size: int) -> None:
    """Raises InvalidInput where an encoder needs more features than the embedding has."""
    least = ENCODERS[encoder].min_features
    if embedding_size < least:
        raise InvalidInput(
            f"`embedding_size` must be at least {least} with the encoder {encoder}; got {embedding_size}.",
            field="config.embedding_size",
        )


class GoalRecognizerNetwork(PolicyNetwork):
    """A goal recognizer of its own, and the in-distribution score of its frames."""

    spec: GoalRecognizerSpec

    def __init__(self, spec: GoalRecognizerSpec) -> None:
        super().__init__()
        self.spec = spec
        self.recognizer = GoalRecognizer(spec.encoder, spec.cameras, embedding_size=spec.embedding_size)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))
