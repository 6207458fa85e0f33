"""Reward `shaping`: potential-based reward shaping (Ng et al. 1999), by keypoints of an object encoder.

They tell how near the body is to the object that the goal moves, and how near that object is to its place.

    F(s, s') = gamma * Phi(s') - Phi(s)

Added to another reward, it changes the returns of all policies from one start by the same, so what is best stays best.
It teaches nothing either once the value function has learned it and nothing else is rewarded: a hand that stands where
a push begins would stay there. So a hand that pushes is rewarded by Phi(s') - Phi(s), as if its reward had a part
(1 - gamma) * Phi(s'): nearness itself is worth a little. It also hides things from the camera; while it does, Phi stays
what it was.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.rewards.carrying import nearness_of
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer


class Shaping(Reward):
    """Rewards an approach, and carrying, at once.

    Args:
        potential: Phi of observations as the network takes them, (..., D) -> (...); that of a terminal state is 0.
        discount: The factor of Phi(s').
        is_known: Where it is known, (..., D) -> bool (...); None for everywhere.
    """

    def __init__(
        self,
        potential: Callable[[Tensor], Tensor],
        discount: float,
        is_known: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        self._potential = potential
        self._discount = discount
        self._is_known = is_known

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns F of each timestep, float32 (T, N)."""
        before, after = self._potential(rollout.observations), self._potential(rollout.next_observations)
        if self._is_known:
            before, after = _kept(before, after, self._is_known(rollout.next_observations), rollout.episode_starts)
        return self._discount * after * ~rollout.terminated - before


def _kept(before: Tensor, after: Tensor, is_known: Tensor, starts: Tensor) -> tuple[Tensor, Tensor]:
    """Returns potentials before and after each timestep, (T, N), in which the last that was known goes on.

    The first of an episode, and of a rollout, counts as known.
    """
    before, after = before.clone(), after.clone()
    for timestep in range(len(before)):
        if timestep:
            before[timestep] = torch.where(starts[timestep], before[timestep], after[timestep - 1])
        after[timestep] = torch.where(is_known[timestep], after[timestep], before[timestep])
    return before, after


def _make(setting: RewardSetting, network: ActorCritic) -> Shaping:
    if network.eye is None:
        raise InvalidInput("Shaping needs the encoder `goal_eye`.", field="config.encoder")
    encoder, config, carried = network.eye, setting.config, nearness_of(setting.caption)

    def potential(features: Tensor) -> Tensor:
        value = config.approach_weight * encoder.nearness(features)
        if config.carry_weight and carried is not None:
            value = value + config.carry_weight * carried(encoder.offset(features))
        return value

    if encoder.pushes:
        return Shaping(potential, 1.0, encoder.sees_both)
    return Shaping(potential, config.gamma)


SHAPING = RewardEntry(
    _make,
    "goal text; the reward model whose encoder locates objects saw images, noun phrases and captions made from pixels",
    frozenset({"frames", "actions"}),
    needs_object_encoder=True,
)
