"""The learner of the forward-consistent goal-conditioned policy (section 3.2).

By default the policy is trained alone, by eq. 3.2. With a forward model, a fit has up to three stages, because jointly
from scratch the policy would follow a model that knows nothing yet:

1. forward: the forward model alone, on executed actions;
2. policy: the policy alone;
3. joint: both, by eq. 3.4, or with `forward_target=pixels` by eq. 3.3.
"""

import torch
from torch import Tensor

from freerein.learning.learner import Items, Losses, Stage
from freerein.learning.train_state import TrainState
from freerein_imitation.methods.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.goal_images.losses import GoalImagesLearner
from freerein_imitation.methods.shared.goal_images.relabelling import RelabelledSlices
from freerein_imitation.methods.shared.losses import action_cross_entropy, masked_mean, squared_error

State = TrainState[GoalConditionedNetwork]


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
        action = masked_mean(action_cross_entropy(logits, executed), slices.mask)
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
        return masked_mean(squared_error(predicted, observed[at + 1]), slices.mask)
