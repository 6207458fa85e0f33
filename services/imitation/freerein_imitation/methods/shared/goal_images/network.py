"""Networks that follow goal images: what they share, and the goal recognizer."""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.model.torch_policy import PolicyNetwork

_MAX_LOGIT = 5.0  # the recognizer's, of two equal images


@dataclass(frozen=True, kw_only=True)
class GoalImagesSpec(InputSpec):
    """Inputs, outputs and sizes of the networks.

    Attributes:
        encoder: Image encoder of the policy and of the recognizer, which share no weights.
        features: Image features per camera of the policy.
        hidden_size: Units of the policy's hidden layers.
        embedding_size: Size of the recognizer's embeddings, and its image features per camera.

    Raises:
        InvalidInput: Cameras, actions or `embedding_size` are out of bounds; an encoder may need more features.
    """

    encoder: str = one_of(ENCODERS, "spatial")
    features: int = bounded(128, least=8, most=1024)
    hidden_size: int = bounded(128, least=8, most=1024)
    embedding_size: int = bounded(64, least=2, most=1024)

    def __post_init__(self) -> None:
        super().__post_init__()
        least = ENCODERS[self.encoder].min_features
        if self.embedding_size < least:
            raise InvalidInput(
                f"`embedding_size` must be at least {least} with the encoder {self.encoder}; "
                f"got {self.embedding_size}.",
                field="config.embedding_size",
            )

    @property
    def categories(self) -> int:
        """Categories of each number of an action."""
        return self.action.choices or action_bins.BINS


class ActionNetwork(Protocol):
    """The part of a network that chooses actions: a torch module.

    Attributes:
        encoder: Encodes observations and goals.
        recurrent_size: R, numbers of recurrent state.
    """

    encoder: CameraEncoders
    recurrent_size: int

    def step(self, features: Tensor, goal: Tensor, previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns action logits, float32 (B, K, A, categories), and the next recurrent states.

        Args:
            features: phi(x_t), float32 (B, D).
            goal: phi(x_g), float32 (B, D).
            previous: a_{t-1}, float32 (B, A), zeros for no action, or int64 (B, 1), -1 for no action.
            recurrent: Recurrent states, float32 (B, R).
        """


class GoalImagesNetwork(PolicyNetwork):
    """Base of the networks: an action network and a goal recognizer, which share no weights."""

    spec: GoalImagesSpec

    def __init__(self, spec: GoalImagesSpec, policy: ActionNetwork) -> None:
        super().__init__()
        self.spec = spec
        self.policy = policy
        self.recognizer = GoalRecognizer(spec)
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))

    def fit_normalisation(self, frames: FrameTensors, *, generator: torch.Generator) -> None:
        """Sets what is not trained of the encoders from training frames, uint8 (N, H, W, C) by camera."""
        self.policy.encoder.fit_normalisation(frames, generator=generator)
        self.recognizer.encoder.fit_normalisation(frames, generator=generator)


class GoalRecognizer(nn.Module):
    """The goal recognizer of section 3.2 as a metric embedding: images a few actions apart are less than 1 apart.

    The dissertation leaves the network open. In a metric nothing is closer to a goal than the goal's own images.
    """

    def __init__(self, spec: GoalImagesSpec) -> None:
        super().__init__()
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.embedding_size)
        self.projection = nn.Linear(self.encoder.size, spec.embedding_size, bias=False)

    def forward(self, frames: FrameTensors) -> Tensor:
        """Returns embeddings, float32 (N, embedding_size), of frames uint8 (N, H, W, C) by camera."""
        embedding: Tensor = self.projection(self.encoder(frames))
        return embedding


def proximity_logit(observation: Tensor, goal: Tensor) -> Tensor:
    """Returns the logit that two embeddings (..., embedding_size) are close, float32 (...)."""
    distance: Tensor = torch.linalg.vector_norm(observation - goal, dim=-1)
    return _MAX_LOGIT * (1 - distance)
