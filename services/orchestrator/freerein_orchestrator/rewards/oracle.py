"""Reward `oracle`: the task's true reward, to compare with."""

from freerein.errors import FailedPrecondition
from freerein_orchestrator.rewards.entry import RewardEntry
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.vec_env import CameraFrames, Rewards


class OracleReward(Reward):
    """Passes the true rewards on."""

    def of_frames(self, _frames: CameraFrames, true_rewards: Rewards | None) -> Rewards:
        """Returns the true rewards.

        Raises:
            FailedPrecondition: The session is not privileged.
        """
        if true_rewards is None:
            raise FailedPrecondition(
                "The oracle's reward needs a privileged session; this one is not.", hint="Ask for a learned reward."
            )
        return true_rewards


ORACLE = RewardEntry(
    lambda *_: OracleReward(),
    "the task's true reward, which is privileged: to compare with",
    frozenset({"true_rewards"}),
    privileged=True,
)
