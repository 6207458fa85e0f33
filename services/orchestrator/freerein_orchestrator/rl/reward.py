"""The reward of a training: the one place in which rewards differ."""

import numpy as np
from torch import Tensor

from freerein.learning.checkpoints import Checkpoint
from freerein_orchestrator.rl.rollout import RolloutBuffer
from freerein_orchestrator.rl.vec_env import CameraFrames, Rewards, moments


class Reward:
    """Rewards frames while a rollout is collected, or the rollout, and may learn from it. This one rewards nothing."""

    def begin(self) -> None:
        """Learns what it must know before the first rollout; not called where it is restored."""

    def of_frames(self, frames: CameraFrames, _true_rewards: Rewards | None) -> Rewards:
        """Returns the rewards of frames that were just collected, float32 (M,).

        Args:
            frames: By camera, uint8 (M, H, W, C), those that M actions led to.
            _true_rewards: Those of the task, float32 (M,); None in an unprivileged session.
        """
        return np.zeros(moments(frames), np.float32)

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the rewards of a rollout before normalisation, float32 (T, N), on the CPU: those of its frames."""
        return rollout.rewards

    def update(self, _rollout: RolloutBuffer) -> dict[str, float]:
        """Learns from a rollout, after the policy has; returns metrics.

        Raises:
            IterationRejected: A weight is not finite.
        """
        return {}

    def snapshot(self) -> Checkpoint:
        """Returns the complete state, for `restore`."""
        return Checkpoint(0, {}, {})

    def restore(self, checkpoint: Checkpoint) -> None:
        """Takes over the state of a snapshot.

        Raises:
            FailedPrecondition: The snapshot was made with another configuration.
        """
