"""Potential-based reward shaping (Ng et al. 1999): what a policy's own eye sees it come nearer to is rewarded at once.

    F(s, s') = gamma * Phi(s') - Phi(s)

The returns of two policies from the same start differ as without it, so what is best stays best.
"""

from collections.abc import Callable

from torch import Tensor

from freerein_orchestrator.rl.rollout import RolloutBuffer


def shaping_rewards(rollout: RolloutBuffer, potential: Callable[[Tensor], Tensor], *, gamma: float) -> Tensor:
    """Returns F of each timestep, float32 (T, N).

    Args:
        rollout: Where the policy went.
        potential: Phi of observations as the network takes them, (..., D) -> (...); that of a terminal state is 0.
        gamma: The policy's discount factor.
    """
    after = potential(rollout.next_observations) * ~rollout.terminated
    return gamma * after - potential(rollout.observations)
