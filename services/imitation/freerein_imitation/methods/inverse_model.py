"""The inverse model, a baseline of chapter 3 (Nair et al. 2017), for goal images.

It is trained on pairs of consecutive observations, a_t = pi(phi(x_t), phi(x_{t+1})), and acts with the goal image in
place of x_{t+1}. It has no recurrence, no previous action and no forward consistency, and the same goal recognizer.
"""

from dataclasses import dataclass

from torch import Tensor, nn
from torch.nn import functional

from freerein.config import bounded
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.losses import GoalImagesLearner, PolicyLosses
from freerein_imitation.methods.shared.goal_images.method import goal_images_method
from freerein_imitation.methods.shared.goal_images.network import ActionNetwork, GoalImagesNetwork, GoalImagesSpec
from freerein_imitation.methods.shared.goal_images.relabelling import RelabelledSlices
from freerein_imitation.methods.shared.losses import masked_mean


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


class InverseModel(ActionNetwork):
    """P(a_t | phi(x_t), phi(x_g))."""

    def __init__(self, spec: GoalImagesSpec) -> None:
        super().__init__(spec)
        self.hidden = nn.Linear(self.seen_size, spec.hidden_size)
        self.action_head = spec.make_head(spec.hidden_size)

    def forward(self, codes: Tensor, goals: Tensor) -> Tensor:
        """Returns contexts, float32 (..., C), for codes of observations and goals, float32 (..., code size) each."""
        return self.context(functional.relu(self.hidden(self.seen(codes, goals))), codes, goals)

    def step(self, codes: Tensor, goals: Tensor, _previous: Tensor, recurrent: Tensor) -> tuple[Tensor, Tensor]:
        """Returns contexts, and the empty recurrent states; see `ActionNetwork.step`."""
        return self(codes, goals), recurrent


class InverseModelLearner(GoalImagesLearner[InverseModelNetwork]):
    """The learner of the inverse model and of the goal recognizer."""

    @property
    def max_steps_per_goal(self) -> int:
        """Control steps after which a goal is abandoned."""
        return 2 * self.config.far_steps

    def network(self) -> InverseModelNetwork:
        """Returns an untrained network."""
        return InverseModelNetwork(self.spec)

    def policy_losses(self, network: InverseModelNetwork, slices: RelabelledSlices) -> PolicyLosses:
        """Returns the action loss, eq. 3.2."""
        codes, head = network.policy.encode(slices.frames), network.policy.action_head  # (N, code size)
        at = slices.timesteps  # (S, L)
        context = network.policy(codes[at], codes[slices.goals][:, None].expand(-1, at.shape[1], -1))
        executed = head.target(slices.actions[at])
        action = masked_mean(head.loss(head.logits(context, executed), executed), slices.mask)
        return PolicyLosses(action, action.new_zeros(()))


METHOD = goal_images_method(InverseModelConfig, GoalImagesSpec, InverseModelNetwork, InverseModelLearner)
