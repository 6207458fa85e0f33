"""Reward `shaping`: potential-based reward shaping (Ng et al. 1999), by how near an eye sees the body to an object.

    F(s, s') = gamma * Phi(s') - Phi(s)

Added to another reward, it changes the returns of all policies from one start by the same, so what is best stays best.
"""

from collections.abc import Callable

from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.actor_critic.networks import ActorCritic
from freerein_orchestrator.rewards.entry import RewardEntry, RewardSetting
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer


class Shaping(Reward):
    """Rewards an approach at once.

    Args:
        potential: Phi of observations as the network takes them, (..., D) -> (...); that of a terminal state is 0.
        config: Has the discount factor, and the weight.
    """

    def __init__(self, potential: Callable[[Tensor], Tensor], config: PPOConfig) -> None:
        self._potential = potential
        self._config = config

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the weighted F of each timestep, float32 (T, N)."""
        after = self._potential(rollout.next_observations) * ~rollout.terminated
        return self._config.approach_weight * (self._config.gamma * after - self._potential(rollout.observations))


def _make(setting: RewardSetting, network: ActorCritic) -> Shaping:
    if network.eye is None:
        raise InvalidInput("Shaping needs the encoder `goal_eye`.", field="config.encoder")
    return Shaping(network.eye.nearness, setting.config)


SHAPING = RewardEntry(
    _make,
    "goal text; the reward model whose encoder locates objects saw images, noun phrases and captions made from pixels",
    frozenset({"frames", "actions"}),
    needs_eye=True,
)
