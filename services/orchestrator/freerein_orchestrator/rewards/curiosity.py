"""Reward `curiosity`: intrinsic rewards for transitions that are badly predicted, learned while the policy is."""

from dataclasses import asdict
from typing import cast

import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import train_state
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein_orchestrator.rewards.entry import RewardEntry
from freerein_orchestrator.rl.icm import FORWARD_BATCH, ICMConfig, Transitions, init_icm, intrinsic_rewards, update_icm
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import RolloutBuffer


class CuriosityReward(Reward):
    """The intrinsic rewards of a curiosity module.

    Args:
        config: Hyperparameters.
        policy: The policy's network, of which it takes the spec and the image calibration.
        transitions: Transitions per rollout.

    Raises:
        InvalidInput: The policy sees no frames.
    """

    def __init__(self, config: ICMConfig, policy: ActorCritic, *, transitions: int) -> None:
        if policy.image is None:
            raise InvalidInput("Curiosity needs frames; got vectors.", hint="Explore a task that has a camera.")
        self._config = config
        self._identity: dict[str, JSON] = {"icm": cast(JSON, asdict(config))}
        device = next(policy.parameters()).device
        self.learner = init_icm(config, policy.spec, transitions=transitions, device=device)
        self.learner.state.network.copy_calibration(policy.image)
        self._mean_reward = 0.0

    def rewards(self, rollout: RolloutBuffer) -> Tensor:
        """Returns the intrinsic rewards of a rollout, float32 (T, N)."""
        rewards = intrinsic_rewards(self.learner.state.network, Transitions.of(rollout), scale=self._config.scale)
        self._mean_reward = rewards.mean().item()
        return rewards.view(rollout.dones.shape)

    def features(self, frames: Tensor) -> Tensor:
        """Returns the features of frames (M, H, W, C), float32 (M, D), on the CPU."""
        network = self.learner.state.network
        device = next(network.parameters()).device
        return torch.cat([network.image(each.to(device)).cpu() for each in torch.split(frames, FORWARD_BATCH)])

    def update(self, rollout: RolloutBuffer) -> dict[str, float]:
        """Trains the module on a rollout; returns its losses and the rollout's mean reward."""
        self.learner, losses = update_icm(self.learner, Transitions.of(rollout), self._config)
        return {**losses, "intrinsic_reward": self._mean_reward}

    def snapshot(self) -> Checkpoint:
        """Returns the complete state."""
        return train_state.to_checkpoint(self.learner, self._identity)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Takes over the state of a snapshot. Raises FailedPrecondition where its configuration was another."""
        self.learner = train_state.from_checkpoint(checkpoint, self.learner, self._identity)


CURIOSITY = RewardEntry(
    lambda setting, network: CuriosityReward(
        ICMConfig(seed=setting.config.seed), network, transitions=setting.config.rollout_size
    ),
    "none",
    frozenset({"frames", "actions"}),
    needs_object_encoder=False,
)
