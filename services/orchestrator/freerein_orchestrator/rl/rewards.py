"""Where the rewards of a rollout come from: the one place in which kinds of reward differ."""

from typing import Protocol

from torch import Tensor

from freerein.learning.checkpoints import Checkpoint
from freerein_orchestrator.rl.rollout import RolloutBuffer


class RewardLearner(Protocol):
    """Rewards rollouts, and may learn from them."""

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the rewards of a rollout before normalisation, float32 (T, N), on the CPU."""

    def update(self, rollout: RolloutBuffer) -> dict[str, float]:
        """Learns from a rollout, after the policy has; returns metrics.

        Raises:
            IterationRejected: A weight is not finite.
        """

    def snapshot(self) -> Checkpoint:
        """Returns the complete state, for `restore`."""

    def restore(self, checkpoint: Checkpoint) -> None:
        """Takes over the state of a snapshot.

        Raises:
            FailedPrecondition: The snapshot was made with another configuration.
        """


class EnvRewards:
    """The rewards that the environments return: the oracle's, a fixed reward model's, or a constant."""

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the rollout's own rewards."""
        return rollout.rewards

    def update(self, rollout: RolloutBuffer) -> dict[str, float]:
        """Does nothing."""
        return {}

    def snapshot(self) -> Checkpoint:
        """Returns an empty state."""
        return Checkpoint(0, {}, {})

    def restore(self, checkpoint: Checkpoint) -> None:
        """Does nothing."""
