"""Configuration and learner of the forward-consistent goal-conditioned policy (section 3.2).

By default the policy is trained alone, by eq. 3.2. With a forward model, a fit has up to three stages, because jointly
from scratch the policy would follow a model that knows nothing yet:

1. forward: the forward model alone, on executed actions;
2. policy: the policy alone;
3. joint: both, by eq. 3.4, or with `forward_target=pixels` by eq. 3.3.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.learning.learner import Items, Losses, Stage
from freerein.learning.train_state import TrainState
from freerein_imitation import objectives
from freerein_imitation.model import action_bins
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.training.goal_images import GoalImagesConfig, GoalImagesLearner
from freerein_imitation.training.goal_relabelling import RelabelledSlices

State = TrainState[GoalConditionedNetwork]


@dataclass(frozen=True)
class GoalConditionedConfig(GoalImagesConfig):
    """Configuration of a fit of a goal-conditioned policy.

    Attributes:
        forward_consistency_weight: Weight of forward consistency, lambda of eq. 3.4, or of the forward model as a
            regulariser; 0 for no forward model.
        forward_use: What the forward model is for: `consistency` of predicted actions with executed ones, or a
            `regulariser` of the image features, which predict what executed actions lead to.
        forward_target: What it predicts: the next `features`, eq. 3.4, or the next `pixels`, eq. 3.3, of a small image.
        forward_pretraining_steps: First optimiser steps, of the forward model alone.
        policy_pretraining_steps: Next optimiser steps, of the policy alone.
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.

    Raises:
        InvalidInput: A key of the forward model has no effect, or pre-training leaves no step.
    """

    forward_consistency_weight: float = bounded(0.0, least=0.0, most=100.0)
    forward_use: Literal["consistency", "regulariser"] = "consistency"
    forward_target: Literal["features", "pixels"] = "features"
    forward_pretraining_steps: int = bounded(0, least=0, most=10_000_000)
    policy_pretraining_steps: int = bounded(0, least=0, most=10_000_000)
    use_previous_action: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = ("forward_use", "forward_target", "forward_pretraining_steps", "policy_pretraining_steps")
        given = [key for key in keys if getattr(self, key) != getattr(GoalConditionedConfig, key)]
        if given and not self.forward_consistency_weight:
            raise InvalidInput(
                f"`{given[0]}` is of fits with a forward model; got it with forward_consistency_weight 0.",
                field=f"config.{given[0]}",
                hint="Set forward_consistency_weight, such as to 0.1.",
            )
        pretraining = self.forward_pretraining_steps + self.policy_pretraining_steps
        if pretraining >= self.steps:
            raise InvalidInput(
                f"Steps of pre-training must be fewer than `steps`, which they are part of; got {pretraining} of "
                f"{self.steps}.",
                field="config.steps",
            )


class GoalConditionedLearner(GoalImagesLearner[GoalConditionedNetwork]):
    """The learner of the policy, of the goal recognizer, and of the forward model if there is one."""

    config: GoalConditionedConfig
    spec: GoalConditionedSpec

    def network(self) -> GoalConditionedNetwork:
        """Returns an untrained network."""
        return GoalConditionedNetwork(self.spec)

    def stages(self) -> tuple[Stage[GoalConditionedNetwork], ...]:
        """Returns the stages of the forward model, of the policy, and of both."""
        forward, policy = self.config.forward_pretraining_steps, self.config.policy_pretraining_steps
        return (
            Stage("forward", forward, self._forward_loss),
            Stage("policy", policy, self._policy_loss),
            Stage("joint", self.config.steps - forward - policy, self.loss),
        )

    def _forward_loss(self, state: State, items: Items) -> Losses:
        network, slices = state.network, self._slices(self.training, self._windows[items].tolist(), state.rng())
        with torch.no_grad():
            features = network.policy.encoder(slices.frames)  # (N, D)
        return {"train_loss": self._forward_error(network, slices, features, self._executed(slices))}

    def _policy_loss(self, state: State, items: Items) -> Losses:
        losses = self.loss(state, items)
        return {**losses, "train_loss": losses["action_loss"] + losses["recognizer_loss"]}

    def policy_losses(self, network: GoalConditionedNetwork, slices: RelabelledSlices) -> tuple[Tensor, Tensor]:
        """Returns the action loss, eq. 3.2, and the terms of the forward model, 0 without one: float () each."""
        features, executed = network.policy.encoder(slices.frames), self._executed(slices)  # (N, D)
        at, weight = slices.timesteps, self.config.forward_consistency_weight  # (S, L)
        logits, _ = network.policy(features[at], features[slices.goals], slices.previous[at])  # (S, L, A, categories)
        action = objectives.masked_mean(objectives.action_cross_entropy(logits, executed), slices.mask)
        if network.forward_model is None:
            return action, action.new_zeros(())
        if self.config.forward_use == "regulariser":
            return action, weight * self._forward_error(network, slices, features, executed)
        fixed = features.detach()  # phi is trained by action prediction alone: else it could shrink until f is right
        forward = self._forward_error(network, slices, fixed, executed)
        return action, forward + weight * self._forward_error(network, slices, fixed, logits.softmax(dim=-1))

    def _executed(self, slices: RelabelledSlices) -> Tensor:
        """Returns the distributions of executed actions, float32 (S, L, A, categories)."""
        return action_bins.encode(slices.actions[slices.timesteps], choices=self.spec.action.choices)

    def _forward_error(
        self, network: GoalConditionedNetwork, slices: RelabelledSlices, features: Tensor, actions: Tensor
    ) -> Tensor:
        """Returns how far what follows is from its prediction, given features (N, D) and actions as distributions."""
        if network.forward_model is None:
            raise TypeError("This network has no forward model.")
        observed = network.forward_model.observed(features, slices.frames)  # (N, O)
        at = slices.timesteps  # (S, L)
        predicted = network.forward_model(features[at], actions, observed[at])
        return objectives.masked_mean(objectives.squared_error(predicted, observed[at + 1]), slices.mask)
