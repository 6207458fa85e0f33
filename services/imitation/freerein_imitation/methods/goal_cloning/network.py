"""Goal-conditioned behavioural cloning for goal images, with a goal recognizer by odometry.

Observation, goal and previous observation meet as features of one spatial encoder, beside their differences, and there
is no recurrence beyond the previous observation (Ghosh et al., "Learning to reach goals via iterated supervised
learning", 2021, in a single iteration).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from freerein.config import bounded, one_of
from freerein.learning.encoders import ENCODERS, CameraEncoders
from freerein.learning.image_statistics import statistics_sizes
from freerein.learning.in_distribution import InDistribution
from freerein.learning.inputs import InputSpec
from freerein_imitation.methods.goal_cloning.odometry_recognizer import OdometryRecognizer, perceptron
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.model.torch_policy import PolicyNetwork

_DEPTH = 3
_GOAL_CONTRAST, _MOTION_CONTRAST = 2.0, 4.0  # of differences of features


@dataclass(frozen=True, kw_only=True)
class GoalCloningSpec(InputSpec):
    """Inputs, outputs and sizes of the network.

    Attributes:
        encoder: Image encoder.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.
        normalise_exposure: Whether frames are made as bright as the training frames.
    """

    encoder: str = one_of(ENCODERS, "moments")
    features: int = bounded(80, least=8, most=1024)
    hidden_size: int = bounded(256, least=8, most=1024)
    normalise_exposure: bool = False

    @property
    def categories(self) -> int:
        """Categories of each number of an action."""
        return self.action.choices or action_bins.BINS


class GoalCloningNetwork(PolicyNetwork):
    """Encoder, policy and goal recognizer."""

    spec: GoalCloningSpec

    def __init__(self, spec: GoalCloningSpec) -> None:
        super().__init__()
        self.spec = spec
        self.encoder = CameraEncoders(
            ENCODERS[spec.encoder], spec.cameras, features=spec.features, normalise_exposure=spec.normalise_exposure
        )
        inputs, outputs = 3 * self.encoder.size + spec.encoded_action_size, spec.action.size * spec.categories
        self.policy = perceptron(inputs, outputs, hidden_size=spec.hidden_size, depth=_DEPTH)
        self.recognizer = OdometryRecognizer(
            features=self.encoder.size, hidden_size=spec.hidden_size, action=spec.action
        )
        self.in_distribution = InDistribution(*statistics_sizes(spec.cameras))

    def forward(self, features: Tensor, goal: Tensor, before: Tensor, previous: Tensor) -> Tensor:
        """Returns action logits, float32 (B, A, categories).

        Args:
            features: Of observations, float32 (B, D).
            goal: Features of goals, float32 (B, D).
            before: Features of the observations one step earlier, float32 (B, D).
            previous: Actions executed last, float32 (B, A), zeros for none, or int64 (B, 1), -1 for none.
        """
        if self.spec.action.choices:
            previous = action_bins.encode(previous, choices=self.spec.action.choices).flatten(1)  # (B, choices)
        differences = _GOAL_CONTRAST * (goal - features), _MOTION_CONTRAST * (features - before)
        logits: Tensor = self.policy(torch.cat([features, *differences, previous], dim=1))
        return logits.view(-1, self.spec.action.size, self.spec.categories)
