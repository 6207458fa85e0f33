"""Proximal policy optimisation (Schulman et al. 2017), with or without a memory.

Departures from the paper are those that everybody makes: advantages are normalised in each minibatch, gradients are
clipped, the first weights are orthogonal (Huang et al. 2022, "The 37 implementation details").

Where experience is collected while the last is learnt from, the policy that acted is not the one that learning begins
with. The clipping is around the latter, every value is its critic's, and each timestep counts as much more or less as
the latter would rather have acted so (Hilton et al. 2022, the decoupled objective), but never more than once (Espeholt
et al. 2018).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning.optimiser import cosine_lr, optimiser_step
from freerein.learning.train_state import FitLoopState
from freerein_orchestrator.hindsight import reconsider
from freerein_orchestrator.networks import ActorCritic, Distribution
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Rollout

_NOTHING = 1e-8


def learn(
    progress: FitLoopState[ActorCritic],
    rollout: Rollout,
    config: PPOConfig,
    *,
    interrupt: Callable[[], None] = lambda: None,
) -> tuple[FitLoopState[ActorCritic], dict[str, float]]:
    """Returns the learner after one iteration's updates, and their metrics. The network is changed in place.

    Args:
        progress: Before them; its sampler is over `config.sequences`.
        rollout: What to learn from.
        config: What was chosen.
        interrupt: Called before each update; what it raises ends them.

    Raises:
        Rejected: A metric or a weight is not finite.
    """
    state, sampler = progress.state, progress.sampler
    samples = prepare(rollout, config, state.network)
    metrics: list[Mapping[str, Tensor]] = []
    for _ in range(config.updates):
        interrupt()
        batch = samples.pick(sampler.next_batch(config.batch_size // config.sequence))
        losses = evaluate(state.network, batch, clip=config.clip)
        rate = cosine_lr(config.lr, state.step, warmup_steps=1, steps=config.iterations * config.updates)
        state = optimiser_step(state, losses.total(config), lr=rate)
        metrics.append(losses.metrics())
    means = {name: torch.stack([each[name] for each in metrics]).mean().item() for name in metrics[0]}
    # the share of the targets' variance that the values explain, whose errors the advantages are
    means["explained_variance"] = 1.0 - (samples.advantages.var() / samples.targets.var().clamp(min=_NOTHING)).item()
    _check_finite(means, state.network)
    return replace(progress, state=state), means


@dataclass(frozen=True, eq=False)
class Samples:
    """B sequences of L timesteps; L is 1 where there is no memory.

    Attributes:
        observations: uint8 (L, B, H, W, C) or float32 (L, B, D).
        starts: Whether an episode begins there, bool (L, B).
        actions: float32 (L, B, A) or int64 (L, B, 1).
        log_probs: Of the actions by the policy that learning begins with, float32 (L, B).
        weights: How much each timestep counts, float32 (L, B).
        advantages: float32 (L, B).
        targets: Of the value, float32 (L, B).
        memory: Before the first timestep, float32 (1, B, memory_size).
    """

    observations: Tensor
    starts: Tensor
    actions: Tensor
    log_probs: Tensor
    weights: Tensor
    advantages: Tensor
    targets: Tensor
    memory: Tensor

    def pick(self, items: npt.NDArray[np.int64]) -> "Samples":
        """Returns some of the sequences."""
        chosen = torch.from_numpy(items)
        return Samples(**{each.name: getattr(self, each.name)[:, chosen] for each in fields(self)})


def prepare(rollout: Rollout, config: PPOConfig, network: ActorCritic) -> Samples:
    """Returns what there is to learn from a rollout: its environments' sequences, or its timesteps one by one.

    Args:
        rollout: By the network, or where experience is collected meanwhile by an earlier one.
        config: What was chosen.
        network: Before its updates; all values are its own, those at the rollout's end and at limits of time too.
    """
    judged = reconsider(rollout, network)
    advantages = estimate_advantages(
        rollout.rewards + config.discount * judged.cut_values,
        judged.values,
        rollout.ends,
        judged.next_values,
        discount=config.discount,
        trace_decay=config.trace_decay,
    )
    whole = Samples(
        observations=rollout.observations,
        starts=rollout.starts,
        actions=rollout.actions,
        log_probs=judged.log_probs,
        weights=(judged.log_probs - rollout.log_probs).exp().clamp(max=1.0),
        advantages=advantages,
        targets=advantages + judged.values,
        memory=rollout.memory[None],
    )
    if config.is_recurrent:
        return whole
    singles = {each.name: getattr(whole, each.name).flatten(end_dim=1)[None] for each in fields(whole)}
    return Samples(**singles | {"memory": rollout.memory.new_zeros(1, rollout.starts.numel(), 0)})


def estimate_advantages(
    rewards: Tensor, values: Tensor, ends: Tensor, next_values: Tensor, *, discount: float, trace_decay: float
) -> Tensor:
    """Returns how much better than expected each action did (Schulman et al. 2016, eq. 16): float32 (T, N).

    Args:
        rewards: float32 (T, N); where an episode was cut off, with the discounted value of what it would have gone on
            from.
        values: Expected before each action, float32 (T, N).
        ends: Whether an episode ended there, bool (T, N).
        next_values: After the last timestep, float32 (N,).
        discount: Gamma.
        trace_decay: Lambda.
    """
    advantages, following = torch.empty_like(rewards), torch.zeros_like(next_values)
    for t in reversed(range(len(rewards))):
        goes_on = (~ends[t]).float()
        surprise = rewards[t] + discount * next_values * goes_on - values[t]
        following = surprise + discount * trace_decay * goes_on * following
        advantages[t], next_values = following, values[t]
    return advantages


@dataclass(frozen=True, eq=False)
class Losses:
    """What an update lowers, and what it shows; numbers.

    Attributes:
        policy: The clipped objective, negative (eq. 7).
        value: The value's squared error.
        entropy: Of the policy, in nats.
        divergence: Of the policy from that which learning began with, in nats, estimated (Schulman 2020).
        clipped_share: The share of timesteps whose ratio of probabilities left the clipping range.
    """

    policy: Tensor
    value: Tensor
    entropy: Tensor
    divergence: Tensor
    clipped_share: Tensor

    def total(self, config: PPOConfig) -> Tensor:
        """Returns what is lowered (eq. 9)."""
        return self.policy + config.value_weight * self.value - config.entropy_weight * self.entropy

    def metrics(self) -> dict[str, Tensor]:
        """Returns the numbers, without their gradients, by the names of the curves."""
        return {
            "policy_loss": self.policy.detach(),
            "value_loss": self.value.detach(),
            "entropy": self.entropy.detach(),
            "divergence": self.divergence,
            "clipped_share": self.clipped_share,
        }


def evaluate(network: ActorCritic, batch: Samples, *, clip: float) -> Losses:
    """Returns the losses of a network on some samples."""
    device = next(network.parameters()).device
    here = Samples(**{each.name: getattr(batch, each.name).to(device) for each in fields(batch)})
    outputs = network(here.observations, here.starts, here.memory[0])
    return clipped_losses(outputs.actions, outputs.values, here, clip=clip)


def clipped_losses(policy: Distribution, values: Tensor, batch: Samples, *, clip: float) -> Losses:
    """Returns the losses of a policy and its values, float32 (L, B), on the samples that they are for."""
    advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + _NOTHING)
    log_ratio = policy.log_prob(batch.actions) - batch.log_probs
    ratio = log_ratio.exp()
    gain = batch.weights * torch.minimum(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip))
    with torch.no_grad():
        divergence = (ratio - 1 - log_ratio).mean()
        clipped_share = ((ratio - 1).abs() > clip).float().mean()
    value = functional.mse_loss(values, batch.targets)
    return Losses(-gain.mean(), value, policy.entropy().mean(), divergence, clipped_share)


def _check_finite(metrics: Mapping[str, float], network: ActorCritic) -> None:
    numbers = dict(metrics) | {"weights": sum(each.detach().sum().item() for each in network.parameters())}
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise Rejected(
                f"A training's numbers must stay finite; {name} became {value}.",
                hint="Lower the learning rate, or look at the rewards.",
            )
