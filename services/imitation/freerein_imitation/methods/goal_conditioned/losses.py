"""The learner of the forward-consistent goal-conditioned policy (section 3.2).

By default the policy is trained alone, by eq. 3.2. With a forward model, a fit has up to three stages, because jointly
from scratch the policy would follow a model that knows nothing yet:

1. policy: the policy alone, with its image features;
2. forward: the forward model alone, on these features and executed actions;
3. joint: both, by eq. 3.4, or with `forward_target=pixels` by eq. 3.3.
"""

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.learner import Items, Losses, Stage
from freerein.learning.train_state import TrainState
from freerein_imitation.methods.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.methods.shared.frame_features import encode_trajectory
from freerein_imitation.methods.shared.goal_images.losses import (
    GoalImagesLearner,
    PolicyLosses,
    without_auxiliary,
)
from freerein_imitation.methods.shared.goal_images.recognizer_losses import goals_ahead
from freerein_imitation.methods.shared.goal_images.relabelling import RelabelledSlices
from freerein_imitation.methods.shared.losses import masked_mean, squared_distance

State = TrainState[GoalConditionedNetwork]

_THRESHOLD_WINDOWS = 32


class GoalConditionedLearner(GoalImagesLearner[GoalConditionedNetwork]):
    """The learner of the policy, of the goal recognizer, and of the forward model if there is one."""

    config: GoalConditionedConfig
    spec: GoalConditionedSpec

    def network(self) -> GoalConditionedNetwork:
        """Returns an untrained network."""
        return GoalConditionedNetwork(self.spec)

    def stages(self) -> tuple[Stage[GoalConditionedNetwork], ...]:
        """Returns the stages of the policy, of the forward model, and of both."""
        forward, policy = self.config.forward_pretraining_steps, self.config.policy_pretraining_steps
        return (
            Stage("policy", policy, self._policy_loss),
            Stage("forward", forward, self._forward_loss),
            Stage("joint", self.config.steps - forward - policy, self.loss),
        )

    def _forward_loss(self, state: State, items: Items) -> Losses:
        network, slices = state.network, self._slices(self.training, self._windows[items].tolist(), state.rng())
        with torch.no_grad():
            features = network.policy.encoder(slices.frames)  # (N, D)
        executed = network.policy.action_head.target(slices.actions[slices.timesteps])
        return {"train_loss": self._forward_error(network, slices, features, executed)}

    def _policy_loss(self, state: State, items: Items) -> Losses:
        losses = self.loss(state, items)
        return {**losses, "train_loss": without_auxiliary(losses)}

    def policy_losses(self, network: GoalConditionedNetwork, slices: RelabelledSlices) -> PolicyLosses:
        """Returns the action loss, eq. 3.2, the terms of the forward model, 0 without one, and the loss of `stop`."""
        policy, head = network.policy, network.policy.action_head
        codes, at = policy.encode(slices.frames), slices.timesteps  # (N, code size), (S, L)
        seen = at if policy.stop_head is None else slices.timesteps_to_goals
        context, _ = policy(codes[seen], codes[slices.goals], slices.previous[seen])  # (S, L, C), or L + 1
        stop = None if policy.stop_head is None else stop_loss(policy.stop_head(context)[..., 0], slices.lengths)
        executed = head.target(slices.actions[at])
        logits = head.logits(context[:, : at.shape[1]], executed)
        action = masked_mean(head.loss(logits, executed), slices.mask)
        if network.forward_model is None:
            return PolicyLosses(action, action.new_zeros(()), stop)
        weight, features = self.config.forward_consistency_weight, codes[:, : policy.encoder.size]
        if self.config.forward_use == "regulariser":
            return PolicyLosses(action, weight * self._forward_error(network, slices, features, executed), stop)
        fixed = features.detach()  # phi is trained by action prediction alone: else it could shrink until f is right
        forward = self._forward_error(network, slices, fixed, executed)
        consistency = self._forward_error(network, slices, fixed, head.distribution(logits))
        return PolicyLosses(action, forward + weight * consistency, stop)

    @property
    def max_steps_per_goal(self) -> int:
        """Control steps after which a goal is abandoned."""
        return super().max_steps_per_goal if self.spec.recurrent else 2 * self.config.far_steps

    @torch.no_grad()
    def reached_ahead(self, network: GoalConditionedNetwork, rng: np.random.Generator) -> Tensor:
        """Returns the probability that each held-out frame, as the first of a goal, is at one ahead, float32 (N,)."""
        if network.recognizer is not None:
            return super().reached_ahead(network, rng)
        reached = []
        for item, length in enumerate(self.validation.lengths().tolist()):
            codes = encode_trajectory(network, self.validation, item)  # (T, G)
            goals = codes[goals_ahead(length, rng, far_steps=self.config.far_steps)]
            previous = torch.from_numpy(np.tile(self.spec.action.no_action(), (length, 1))).to(self.device)
            recurrent = codes.new_zeros(length, network.policy.recurrent_size)
            context, _ = network.policy.step(codes, goals, previous, recurrent)
            reached.append(network.reached(context, codes, goals))
        return torch.cat(reached)

    @torch.no_grad()
    def reached_threshold(self, network: GoalConditionedNetwork) -> float:
        """Returns the probability from which a goal counts as reached: of `stop`, its median at held-out goals."""
        if network.policy.stop_head is None:
            return super().reached_threshold(network)
        windows, rng = self.validation.windows(self.config.max_goal_steps), np.random.default_rng(self.config.seed)
        spread = windows[:: math.ceil(len(windows) / _THRESHOLD_WINDOWS)].tolist()
        slices = self._slices(self.validation, spread, rng)
        codes, seen = network.policy.encode(slices.frames), slices.timesteps_to_goals
        context, _ = network.policy(codes[seen], codes[slices.goals], slices.previous[seen])  # (S, L + 1, C)
        at_goals = context[torch.arange(len(seen)), slices.lengths]  # (S, C)
        return float(network.policy.stop_head(at_goals).sigmoid().median())

    def _forward_error(
        self, network: GoalConditionedNetwork, slices: RelabelledSlices, features: Tensor, actions: Tensor
    ) -> Tensor:
        """Returns how far what follows is from its prediction, given features (N, D) and actions as distributions."""
        if network.forward_model is None:
            raise TypeError("This network has no forward model.")
        observed = network.forward_model.observed(features, slices.frames)  # (N, O)
        at = slices.timesteps  # (S, L)
        predicted = network.forward_model(features[at], actions, observed[at])
        return masked_mean(squared_distance(predicted, observed[at + 1]), slices.mask)


def stop_loss(logits: Tensor, lengths: Tensor) -> Tensor:
    """Returns the cross-entropy of stopping at the goal, and of going on before it, float ().

    With the loss of the action it is that of an action space with a further choice.

    Args:
        logits: Of stopping, at the timesteps of slices up to their goals, float (S, L + 1).
        lengths: Actions in each slice, int64 (S,).
    """
    time, last = torch.arange(logits.shape[1], device=logits.device), lengths[:, None]
    return masked_mean(functional.softplus(torch.where(time == last, -logits, logits)), time <= last)
