"""Proximal policy optimisation (Schulman et al. 2017), with or without a recurrent network.

The usual departures from the paper: advantages are normalised per minibatch, gradients are clipped, weights are
initialised orthogonally (Huang et al. 2022, "The 37 implementation details of PPO").
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.actor_critic.distributions import Distribution
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.optimiser import optimiser_step
from freerein.learning.train_state import FitLoopState
from freerein_orchestrator.rl.config import PPOConfig, Schedule
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.rollout import RolloutBuffer

_EPSILON = 1e-8


def update(
    learner: FitLoopState[ActorCritic],
    rollout: RolloutBuffer,
    rewards: Tensor,
    config: PPOConfig,
    *,
    schedule: Schedule,
    interrupt: Callable[[], None] = lambda: None,
) -> tuple[FitLoopState[ActorCritic], dict[str, float]]:
    """Returns the learner after one iteration's optimiser steps, and their mean metrics. Changes the network in place.

    Args:
        learner: Its data order is over the rollout's sequences.
        rollout: Collected with the learner's weights.
        rewards: Possibly normalised, float32 (T, N).
        config: Hyperparameters.
        schedule: Of the learning rate.
        interrupt: Called before each optimiser step; raises to stop.

    Raises:
        IterationRejected: A metric or a weight is not finite.
    """
    state, batch = learner.state, training_batch(rollout, rewards, config)
    metrics: list[Mapping[str, Tensor]] = []
    for _ in range(config.steps_per_iteration):
        interrupt()
        minibatch = batch.select(learner.sampler.next_batch(config.batch_size // config.sequence_length))
        losses = evaluate(state.network, minibatch, clip_range=config.clip_range)
        state = optimiser_step(state, losses.total(config), lr=schedule.lr(config, state.step))
        metrics.append(losses.metrics())
    means = {name: torch.stack([each[name] for each in metrics]).mean().item() for name in metrics[0]}
    means["explained_variance"] = 1.0 - (batch.advantages.var() / batch.returns.var().clamp(min=_EPSILON)).item()
    _check_finite(means, state.network)
    return replace(learner, state=state), means


@dataclass(frozen=True, eq=False)
class Batch:
    """B sequences of L timesteps; L is 1 unless the policy is recurrent.

    Attributes:
        observations: uint8 (L, B, H, W, C) or float32 (L, B, D).
        episode_starts: bool (L, B).
        actions: float32 (L, B, A) or int64 (L, B, 1).
        log_probs: Under the policy that collected, float32 (L, B).
        advantages: float32 (L, B).
        returns: Targets of the value, float32 (L, B).
        recurrent_state: Before the first timestep, float32 (1, B, recurrent_size).
    """

    observations: Tensor
    episode_starts: Tensor
    actions: Tensor
    log_probs: Tensor
    advantages: Tensor
    returns: Tensor
    recurrent_state: Tensor

    def select(self, sequences: npt.NDArray[np.int64]) -> "Batch":
        """Returns some of the sequences."""
        chosen = torch.from_numpy(sequences)
        return Batch(**{each.name: getattr(self, each.name)[:, chosen] for each in fields(self)})

    def to(self, device: torch.device) -> "Batch":
        """Returns the batch on a device."""
        return Batch(**{each.name: getattr(self, each.name).to(device) for each in fields(self)})


def training_batch(rollout: RolloutBuffer, rewards: Tensor, config: PPOConfig) -> Batch:
    """Returns the rollout with advantages and returns: N sequences if the policy is recurrent, else T * N timesteps."""
    advantages = generalised_advantages(
        rewards + config.gamma * rollout.truncated_values,
        rollout.values,
        rollout.dones,
        rollout.last_values,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
    )
    batch = Batch(
        observations=rollout.observations,
        episode_starts=rollout.episode_starts,
        actions=rollout.actions,
        log_probs=rollout.log_probs,
        advantages=advantages,
        returns=advantages + rollout.values,
        recurrent_state=rollout.recurrent_state[None],
    )
    if config.recurrent:
        return batch
    flat = {each.name: getattr(batch, each.name).flatten(end_dim=1)[None] for each in fields(batch)}
    return Batch(**flat | {"recurrent_state": torch.zeros(1, rollout.dones.numel(), 0)})


def generalised_advantages(
    rewards: Tensor, values: Tensor, dones: Tensor, last_values: Tensor, *, gamma: float, gae_lambda: float
) -> Tensor:
    """Returns generalised advantage estimates (Schulman et al. 2016, eq. 16), float32 (T, N).

    Args:
        rewards: float32 (T, N); plus the discounted value of the final observation where an episode was truncated.
        values: float32 (T, N).
        dones: Whether an episode ended, bool (T, N).
        last_values: After the last timestep, float32 (N,).
        gamma: Discount factor.
        gae_lambda: Lambda.
    """
    advantages, next_values, next_advantage = torch.empty_like(rewards), last_values, torch.zeros_like(last_values)
    for t in reversed(range(len(rewards))):
        not_done = (~dones[t]).float()
        delta = rewards[t] + gamma * next_values * not_done - values[t]
        next_advantage = delta + gamma * gae_lambda * not_done * next_advantage
        advantages[t], next_values = next_advantage, values[t]
    return advantages


@dataclass(frozen=True, eq=False)
class PPOLosses:
    """PPO loss terms and diagnostics, scalars.

    Attributes:
        policy: Negative clipped surrogate objective (eq. 7).
        value: Mean squared error of the value.
        entropy: Mean entropy of the policy, in nats.
        approx_kl: Estimated KL divergence from the policy that collected (Schulman 2020), in nats.
        clip_fraction: Fraction of timesteps whose ratio is clipped.
    """

    policy: Tensor
    value: Tensor
    entropy: Tensor
    approx_kl: Tensor
    clip_fraction: Tensor

    def total(self, config: PPOConfig) -> Tensor:
        """Returns the loss that is minimised (eq. 9)."""
        return self.policy + config.vf_coef * self.value - config.ent_coef * self.entropy

    def metrics(self) -> dict[str, Tensor]:
        """Returns the terms, detached, by metric name."""
        return {
            "policy_loss": self.policy.detach(),
            "value_loss": self.value.detach(),
            "entropy": self.entropy.detach(),
            "approx_kl": self.approx_kl,
            "clip_fraction": self.clip_fraction,
        }


def evaluate(network: ActorCritic, batch: Batch, *, clip_range: float) -> PPOLosses:
    """Returns the losses of a network on a batch."""
    batch = batch.to(next(network.parameters()).device)
    outputs = network(batch.observations, batch.episode_starts, batch.recurrent_state[0])
    return clipped_losses(outputs.actions, outputs.values, batch, clip_range=clip_range)


def clipped_losses(policy: Distribution, values: Tensor, batch: Batch, *, clip_range: float) -> PPOLosses:
    """Returns the losses of action distributions and values, float32 (L, B), on their batch."""
    advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + _EPSILON)
    log_ratio = policy.log_prob(batch.actions) - batch.log_probs
    ratio = log_ratio.exp()
    objective = torch.minimum(advantages * ratio, advantages * ratio.clamp(1 - clip_range, 1 + clip_range))
    with torch.no_grad():
        approx_kl = (ratio - 1 - log_ratio).mean()
        clip_fraction = ((ratio - 1).abs() > clip_range).float().mean()
    value = functional.mse_loss(values, batch.returns)
    return PPOLosses(-objective.mean(), value, policy.entropy().mean(), approx_kl, clip_fraction)


def _check_finite(metrics: Mapping[str, float], network: ActorCritic) -> None:
    numbers = {**metrics, "weights": sum(each.detach().sum().item() for each in network.parameters())}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise IterationRejected(
                f"Training metrics must stay finite; {name} became {value}.",
                hint="Lower the learning rate, or check the rewards.",
            )
