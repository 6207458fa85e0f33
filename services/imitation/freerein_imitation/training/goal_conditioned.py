"""Configuration and losses of the goal-conditioned policy (section 3.2)."""

from dataclasses import dataclass

from torch import Tensor

from freerein.learning.config import bounded
from freerein.learning.inputs import spec_of
from freerein.types.common import ActionSpec, Camera
from freerein_imitation import objectives
from freerein_imitation.model import action_bins
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.training.goal_images import GoalImagesConfig
from freerein_imitation.training.goal_relabelling import RelabelledSlices


@dataclass(frozen=True)
class GoalConditionedConfig(GoalImagesConfig):
    """Configuration of a fit of a goal-conditioned policy.

    Attributes:
        forward_consistency_weight: lambda of eq. 3.4; 0 for no forward model.
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.
    """

    forward_consistency_weight: float = bounded(0.0, least=0.0, most=100.0)
    use_previous_action: bool = True


def network_spec(
    config: GoalConditionedConfig, *, cameras: tuple[Camera, ...], action: ActionSpec
) -> GoalConditionedSpec:
    """Returns the spec of the networks for some cameras and actions.

    Raises:
        InvalidInput: Frames or actions are out of bounds.
    """
    forward_model = config.forward_consistency_weight > 0
    return spec_of(config, GoalConditionedSpec, cameras=cameras, action=action, forward_model=forward_model)


def policy_losses(
    network: GoalConditionedNetwork, slices: RelabelledSlices, *, consistency_weight: float
) -> tuple[Tensor, Tensor]:
    """Returns the action loss, eq. 3.2, and the forward model's terms of eq. 3.4, 0 without one: float () each."""
    features = network.policy.encoder(slices.frames)  # (N, D)
    at, mask = slices.timesteps, slices.mask  # (S, L)
    executed = action_bins.encode(slices.actions[at], choices=network.spec.action.choices)  # (S, L, A, categories)
    logits, _ = network.policy(features[at], features[slices.goals], slices.previous[at])  # (S, L, A, categories)
    action = objectives.masked_mean(objectives.action_cross_entropy(logits, executed), mask)
    if (model := network.forward_model) is None:
        return action, action.new_zeros(())
    fixed = features.detach()  # phi is trained by action prediction alone: else it could shrink until f is right
    now, following = fixed[at], fixed[at + 1]  # (S, L, D)
    forward = objectives.masked_mean(objectives.squared_error(model(now, executed), following), mask)
    predicted = model(now, logits.softmax(dim=-1))
    consistency = objectives.masked_mean(objectives.squared_error(predicted, following), mask)
    return action, forward + consistency_weight * consistency
