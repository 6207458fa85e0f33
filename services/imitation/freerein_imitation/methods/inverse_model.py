"""The inverse model, a baseline of chapter 3 (Nair et al. 2017), for goal images.

It is trained on pairs of consecutive observations, a_t = pi(phi(x_t), phi(x_{t+1})), and acts with the goal image in
place of x_{t+1}. It has no recurrence, no previous action and no forward consistency, and the same goal recognizer.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded
from freerein.learning.encoders import ENCODERS, CameraEncoders
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.losses import GoalImagesLearner
from freerein_imitation.methods.shared.goal_images.method import goal_images_method
from freerein_imitation.methods.shared.goal_images.network import GoalImagesNetwork, GoalImagesSpec
from freerein_imitation.methods.shared.goal_images.relabelling import RelabelledSlices
from freerein_imitation.methods.shared.losses import action_cross_entropy, masked_mean


@dataclass(frozen=True)
class InverseModelConfig(GoalImagesConfig):
    """Configuration of a fit of an inverse model.

    Attributes:
        min_goal_steps: Fewest actions between the two images of a pair.
        max_goal_steps: Most actions between the two images of a pair.
    """

    min_goal_steps: int = bounded(1, least=1, most=1000)
    max_goal_steps: int = bounded(1, least=1, most=1000)


class InverseModelNetwork(GoalImagesNetwork):
    """Inverse model and goal recognizer, which share no weights."""

    policy: "InverseModel"

    def __init__(self, spec: GoalImagesSpec) -> None:
        super().__init__(spec, InverseModel(spec))


class InverseModel(nn.Module):
    """P(a_t | phi(x_t), phi(x_g))."""

    recurrent_size = 0

    def __init__(self, spec: GoalImagesSpec) -> None:
        super().__init__()
        self._shape = spec.action.size, spec.categories
        self.encoder = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        self.hidden = nn.Linear(2 * self.encoder.size, spec.hidden_size)
        self.action_head = nn.Linear(spec.hidden_size, spec.action.size * spec.categories)

    def forward(self, features: Tensor, goal: Tensor) -> Tensor:
        """Returns action logits, float32 (..., A, categories), for phi(x_t) and phi(x_g), float32 (..., D) each."""
        hidden = functional.relu(self.hidden(torch.cat([features, goal], dim=-1)))
        logits: Tensor = self.action_head(hidden)  # (..., A * categories)
        return logits.view(*logits.shape[:-1], *self._shape)

    def step(self, features: Tensor, goal: Tensor, _previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the logits of one action, and the empty recurrent states; see `ActionNetwork.step`."""
        return self(features, goal)[:, None], recurrent


class InverseModelLearner(GoalImagesLearner[InverseModelNetwork]):
    """The learner of the inverse model and of the goal recognizer."""

    @property
    def max_steps_per_goal(self) -> int:
        """Control steps after which a goal is abandoned."""
        return 2 * self.config.far_steps

    def network(self) -> InverseModelNetwork:
        """Returns an untrained network."""
        return InverseModelNetwork(self.spec)

    def policy_losses(self, network: InverseModelNetwork, slices: RelabelledSlices) -> tuple[Tensor, Tensor]:
        """Returns the action loss, eq. 3.2, and 0."""
        features = network.policy.encoder(slices.frames)  # (N, D)
        at = slices.timesteps  # (S, L)
        logits = network.policy(features[at], features[slices.goals][:, None].expand(-1, at.shape[1], -1))
        executed = action_bins.encode(slices.actions[at], choices=self.spec.action.choices)  # (S, L, A, categories)
        action = masked_mean(action_cross_entropy(logits, executed), slices.mask)
        return action, action.new_zeros(())


METHOD = goal_images_method(InverseModelConfig, GoalImagesSpec, InverseModelNetwork, InverseModelLearner)
