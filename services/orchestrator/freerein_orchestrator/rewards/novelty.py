"""Reward `novelty`: what the episode has not shown yet, by features of an inverse model that learns meanwhile.

The features are the curiosity module's, which keep what actions influence. Its forward error, the reward `curiosity`,
is larger where a camera turns than where it drives, in known rooms, too: a turn shows what no model can predict.
"""

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.checkpoints import Checkpoint
from freerein_orchestrator.rewards.curiosity import CuriosityReward
from freerein_orchestrator.rewards.entry import RewardEntry
from freerein_orchestrator.rl.episodic_novelty import episodic_bonuses, first_inverse
from freerein_orchestrator.rl.icm import ICMConfig, Transitions
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer

_RIDGE = 0.1
"""Of Henaff et al. (2022); features have the length 1."""

_EPOCHS = 2
"""Passes of the inverse model over each rollout."""

_INVERSES = "novelty/inverses"


class NoveltyReward(Reward):
    """The episodic bonuses of what each action led to.

    Args:
        seed: Of the module's random draws.
        policy: The policy's network, of which it takes the spec and the image calibration.
        num_envs: Parallel environments.
        transitions: Transitions per rollout.

    Raises:
        InvalidInput: The policy sees no frames.
    """

    def __init__(self, seed: int, policy: ActorCritic, *, num_envs: int, transitions: int) -> None:
        config = ICMConfig(forward_weight=0.0, epochs=_EPOCHS, seed=seed)
        self._module = CuriosityReward(config, policy, transitions=transitions)
        self._inverses = first_inverse(policy.spec.feature_size, ridge=_RIDGE).repeat(num_envs, 1, 1)

    @torch.no_grad()
    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the bonuses of a rollout, float32 (T, N)."""
        steps, shape = Transitions.of(rollout), rollout.dones.shape
        before, after = (
            self._features(each).view(*shape, -1) for each in (steps.observations, steps.next_observations)
        )
        bonuses, self._inverses = episodic_bonuses(before, after, rollout.episode_starts, self._inverses, ridge=_RIDGE)
        return bonuses.float()

    def update(self, rollout: RolloutBuffer) -> dict[str, float]:
        """Trains the inverse model on a rollout; returns its loss."""
        return {"inverse_loss": self._module.update(rollout)["inverse_loss"]}

    def snapshot(self) -> Checkpoint:
        """Returns the complete state."""
        module = self._module.snapshot()
        return replace(module, tensors={**module.tensors, _INVERSES: self._inverses})

    def restore(self, checkpoint: Checkpoint) -> None:
        """Takes over the state of a snapshot. Raises FailedPrecondition where its configuration was another."""
        self._module.restore(checkpoint)
        self._inverses = checkpoint.tensors[_INVERSES]

    def _features(self, frames: Tensor) -> Tensor:
        """Returns features of length 1 of frames (M, H, W, C), float64 (M, D), on the CPU."""
        features = self._module.features(frames)
        return functional.normalize(features, dim=1).double()


NOVELTY = RewardEntry(
    lambda setting, network: NoveltyReward(
        setting.config.seed, network, num_envs=setting.config.num_envs, transitions=setting.config.rollout_size
    ),
    "none",
    frozenset({"frames", "actions"}),
    needs_object_encoder=False,
)
