"""A training by PPO: its complete state between two iterations, to a checkpoint and back, bit by bit.

No experience is saved. A snapshot says where the next rollout begins, environments and all, and who acts in it, so that
it can be collected again.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from typing import cast

import numpy as np
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import train_state, weights
from freerein.learning.batch_sampler import BatchSampler
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.config import parse
from freerein.learning.train_state import FitLoopState, TrainState
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.reward_scale import RewardScale
from freerein_orchestrator.rollout import (
    Environments,
    Observations,
    Rollout,
    Standing,
    checked_observations,
    collect,
    executable,
)
from freerein_orchestrator.tally import Tally

_CALIBRATION_STEPS = 64
_EPSILON = 1e-5  # of Adam


def design(
    config: PPOConfig, *, observation: tuple[int, ...], action_size: int = 1, action_choices: int = 0
) -> ActorCriticSpec:
    """Returns the networks that a configuration asks for.

    Args:
        config: What was chosen.
        observation: Shape of one observation: (H, W, C) of a frame, (D,) of a vector.
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.

    Raises:
        InvalidInput: There are no networks for such observations or actions.
    """
    match observation:
        case (height, width, channels):
            seen = {"height": height, "width": width, "channels": channels}
        case (size,):
            seen = {"vector_size": size}
        case _:
            raise InvalidInput(f"An observation must have the shape (H, W, C) or (D,); got {observation}.")
    return ActorCriticSpec(
        **seen,
        action_size=action_size,
        action_choices=action_choices,
        features=config.features,
        hidden=config.hidden,
        is_recurrent=config.is_recurrent,
        log_std=config.log_std,
    )


@dataclass(frozen=True, eq=False)
class Outset:
    """Where a rollout begins: all that it depends on, but for the actor.

    Attributes:
        standing: Where the environments' episodes stand.
        generator: The state of what draws the actions, uint8.
        environments: How to bring the environments back to where they stand.
    """

    standing: Standing
    generator: Tensor
    environments: tuple[bytes, ...]


@dataclass(frozen=True, eq=False)
class PPOTraining:
    """Everything that the next iteration depends on.

    Attributes:
        config: What was chosen.
        progress: The learner: network, optimiser, updates made, the order of minibatches.
        actor: Collects the next rollout; never changed.
        outset: Where that begins.
        terms: What else it was begun with and must be gone on with.
        metrics: Of the last iteration; none before the first.
    """

    config: PPOConfig
    progress: FitLoopState[ActorCritic]
    actor: ActorCritic
    outset: Outset
    terms: Mapping[str, JSON] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)

    @property
    def network(self) -> ActorCritic:
        """The actor and the critic, as they have learnt so far."""
        return self.progress.state.network

    @property
    def iteration(self) -> int:
        """Iterations made."""
        return self.progress.state.step // self.config.updates


def begin(
    config: PPOConfig,
    spec: ActorCriticSpec,
    environments: Environments,
    *,
    device: torch.device,
    taught: ActorCritic | None = None,
    terms: Mapping[str, JSON] | None = None,
) -> PPOTraining:
    """Returns a training before its first iteration, and begins an episode in every environment.

    Frames are calibrated on those that random actions lead to.

    Args:
        config: What was chosen.
        spec: The networks.
        environments: Where experience will be collected.
        device: Where the networks are.
        taught: A network of the same spec whose weights and calibration the training begins with.
        terms: What else it is begun with and must be gone on with.

    Raises:
        InvalidInput: The environments are not as many as configured, or do not show what the network sees.
    """
    if environments.num_envs != config.num_envs:
        raise InvalidInput(
            f"There must be {config.num_envs} environments; got {environments.num_envs}.", field="num_envs"
        )
    progress = _untrained(config, spec, device)
    network, generator = progress.state.network, progress.state.generator
    if taught is not None:
        network.load_state_dict(taught.state_dict())
    elif not spec.vector_size:
        network.calibrate(_wander(environments, spec, generator).to(device))
    scale = RewardScale.begin(config.num_envs) if config.scale_rewards else None
    standing = Standing.begin(environments.reset(), spec, Tally.begin(config.num_envs, scale=scale))
    outset = Outset(standing, generator.get_state(), environments.snapshots())
    return PPOTraining(config, progress, frozen(network), outset, terms or {})


def frozen(network: ActorCritic) -> ActorCritic:
    """Returns a copy of a network that nothing changes."""
    return deepcopy(network).requires_grad_(False)


def roll_out(
    actor: ActorCritic, outset: Outset, environments: Environments, config: PPOConfig
) -> tuple[Rollout, Outset]:
    """Returns the rollout that begins at an outset where the environments stand, and the outset of the next one.

    Raises:
        Rejected: An environment answered what is no step, or a reward is not finite.
        ServiceError: What else stepping the environments raises.
    """
    generator = torch.Generator()
    generator.set_state(outset.generator)
    rollout, standing = collect(
        actor, environments, outset.standing, steps=config.steps, discount=config.discount, generator=generator
    )
    return rollout, Outset(standing, generator.get_state(), environments.snapshots())


def snapshot(training: PPOTraining) -> Checkpoint:
    """Returns a copy of a training, which nothing that follows changes; for `freerein.learning.checkpoints`, too.

    Args:
        training: Between two iterations.
    """
    identity = _identity(training.config, training.network, training.terms)
    made = train_state.to_checkpoint(training.progress, identity)
    tensors = {
        **made.tensors,
        **{f"actor/{name}": tensor for name, tensor in training.actor.state_dict().items()},
        **{f"outset/{name}": tensor for name, tensor in _to_tensors(training.outset).items()},
    }
    return replace(
        made,
        tensors={name: tensor.detach().clone() for name, tensor in tensors.items()},
        document={**made.document, "metrics": dict(training.metrics)},
    )


def restore(
    checkpoint: Checkpoint, config: PPOConfig, *, device: torch.device, terms: Mapping[str, JSON] | None = None
) -> PPOTraining:
    """Returns the training that a snapshot is of.

    Args:
        checkpoint: From `snapshot`.
        config: As the training was begun with.
        device: As well.
        terms: Those of its terms that could be others by now.

    Raises:
        FailedPrecondition: The snapshot is of a training with another configuration or other terms, on another device
            or by another torch.
    """
    begun = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    fresh = _untrained(config, parse(ActorCriticSpec, begun["network"]), device)
    network, terms = fresh.state.network, {**begun["terms"], **(terms or {})}
    actor = frozen(network)
    progress = train_state.from_checkpoint(checkpoint, fresh, _identity(config, network, terms))
    actor.load_state_dict(_under("actor/", checkpoint.tensors))
    outset = _from_tensors(_under("outset/", checkpoint.tensors))
    metrics = cast(Mapping[str, float], checkpoint.document["metrics"])
    return PPOTraining(config, progress, actor, outset, terms, metrics)


def _untrained(config: PPOConfig, spec: ActorCriticSpec, device: torch.device) -> FitLoopState[ActorCritic]:
    generator = torch.Generator().manual_seed(config.seed)
    network = ActorCritic(spec)
    weights.initialise(network, generator=generator)
    network = network.to(device)
    optimiser = torch.optim.Adam(network.parameters(), config.lr, eps=_EPSILON, fused=True)
    sampler = BatchSampler.start(config.sequences, rng=np.random.default_rng(config.seed))
    return FitLoopState(TrainState(network, optimiser, generator), sampler)


def _wander(environments: Environments, spec: ActorCriticSpec, generator: torch.Generator) -> Tensor:
    """Returns the frames that random actions lead to, uint8 (N, H, W, C)."""
    seen: list[Observations] = [environments.reset()]
    size = environments.num_envs, spec.action_size
    for _ in range(_CALIBRATION_STEPS):
        if spec.action_choices:
            actions = torch.randint(spec.action_choices, size, generator=generator)
        else:
            actions = 2 * torch.rand(size, generator=generator) - 1
        seen.append(environments.step(executable(actions)).observations)
    environments.rewards()  # which nobody learns from
    return torch.cat([checked_observations(each, spec, environments.num_envs) for each in seen])


def _identity(config: PPOConfig, network: ActorCritic, terms: Mapping[str, JSON]) -> dict[str, JSON]:
    device = next(network.parameters()).device
    return {
        "config": asdict(config),
        "network": asdict(network.spec),
        "torch": torch.__version__,
        "device": str(device),
        "terms": dict(terms),
    }


def _to_tensors(outset: Outset) -> dict[str, Tensor]:
    standing, tally = outset.standing, outset.standing.tally
    parts = {
        "generator": outset.generator,
        "observations": standing.observations,
        "starts": standing.starts,
        "memory": standing.memory,
        "returns": tally.returns,
        "lengths": tally.lengths,
    }
    if tally.scale is not None:
        parts |= {"scale/sums": tally.scale.sums, "scale/moments": tally.scale.moments}
    return parts | {f"environments/{index}": _from_bytes(data) for index, data in enumerate(outset.environments)}


def _from_tensors(tensors: Mapping[str, Tensor]) -> Outset:
    is_scaled = "scale/sums" in tensors
    scale = RewardScale(tensors["scale/sums"], tensors["scale/moments"]) if is_scaled else None
    tally = Tally(tensors["returns"], tensors["lengths"], scale)
    standing = Standing(tensors["observations"], tensors["starts"], tensors["memory"], tally)
    count = len(_under("environments/", tensors))
    environments = tuple(tensors[f"environments/{index}"].numpy().tobytes() for index in range(count))
    return Outset(standing, tensors["generator"], environments)


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}


def _from_bytes(data: bytes) -> Tensor:
    return torch.from_numpy(np.frombuffer(data, np.uint8).copy())
