"""Reward `shaping`: potential-based reward shaping (Ng et al. 1999), by keypoints of an object encoder.

They tell how near the body is to the object that the goal moves, and how near that object is to its place.

    F(s, s') = gamma * Phi(s') - Phi(s)

Added to another reward, it changes the returns of all policies from one start by the same, so what is best stays best.
"""

from collections.abc import Callable

from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.rewards.carrying import nearness_of
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer


class Shaping(Reward):
    """Rewards an approach, and carrying, at once.

    Args:
        potential: Phi of observations as the network takes them, (..., D) -> (...); that of a terminal state is 0.
        config: Has the discount factor.
    """

    def __init__(self, potential: Callable[[Tensor], Tensor], config: PPOConfig) -> None:
        self._potential = potential
        self._config = config

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns F of each timestep, float32 (T, N)."""
        after = self._potential(rollout.next_observations) * ~rollout.terminated
        return self._config.gamma * after - self._potential(rollout.observations)


def _make(setting: RewardSetting, network: ActorCritic) -> Shaping:
    if network.eye is None:
        raise InvalidInput("Shaping needs the encoder `goal_eye`.", field="config.encoder")
    encoder, config, carried = network.eye, setting.config, nearness_of(setting.caption)

    def potential(features: Tensor) -> Tensor:
        value = config.approach_weight * encoder.nearness(features)
        if config.carry_weight and carried is not None:
            value = value + config.carry_weight * carried(encoder.offset(features))
        return value

    return Shaping(potential, config)


SHAPING = RewardEntry(
    _make,
    "goal text; the reward model whose encoder locates objects saw images, noun phrases and captions made from pixels",
    frozenset({"frames", "actions"}),
    needs_object_encoder=True,
)
