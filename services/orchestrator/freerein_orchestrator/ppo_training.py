"""A training by PPO: its complete state between two iterations, to a checkpoint and back, bit by bit.

What a snapshot does not hold is the environments themselves. Whoever has them brings their state along as bytes, which
are saved in the same checkpoint: snapshots of simulated worlds, or what it takes to replay them.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from freerein.errors import FailedPrecondition, InvalidInput
from freerein.learning import progress as progresses
from freerein.learning import weights
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.progress import Progress, TrainingState
from freerein.learning.shuffle import Shuffle
from freerein_orchestrator.networks import ActorCritic, ActorCriticSpec
from freerein_orchestrator.ppo import learn
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.reward_scale import RewardScale
from freerein_orchestrator.rollout import (
    Environments,
    Observations,
    Standing,
    checked_observations,
    collect,
    executable,
)

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
class PPOTraining:
    """Everything that the next iteration depends on, but for the environments.

    Attributes:
        config: What was chosen.
        progress: The learner: network, optimiser, updates made, the order of minibatches; and, as the generator of its
            state, what draws the actions.
        standing: Where the environments' episodes stand.
    """

    config: PPOConfig
    progress: Progress[ActorCritic]
    standing: Standing

    @property
    def network(self) -> ActorCritic:
        """The actor and the critic."""
        return self.progress.state.network

    @property
    def iteration(self) -> int:
        """Iterations made."""
        return self.progress.state.step // self.config.updates


def begin(config: PPOConfig, spec: ActorCriticSpec, environments: Environments, *, device: torch.device) -> PPOTraining:
    """Returns a training before its first iteration, and begins an episode in every environment.

    Frames are calibrated on those that random actions lead to.

    Raises:
        InvalidInput: The environments are not as many as configured, or do not show what the network sees.
    """
    if environments.num_envs != config.num_envs:
        raise InvalidInput(
            f"There must be {config.num_envs} environments; got {environments.num_envs}.", field="num_envs"
        )
    progress = _untrained(config, spec, device)
    scale = RewardScale.begin(config.num_envs) if config.scale_rewards else None
    if not spec.vector_size:
        progress.state.network.calibrate(_wander(environments, spec, progress.state.generator).to(device))
    return PPOTraining(config, progress, Standing.begin(environments.reset(), spec, scale=scale))


def iterate(training: PPOTraining, environments: Environments) -> tuple[PPOTraining, dict[str, float]]:
    """Returns the training after one iteration, and its metrics; networks and generators are changed in place.

    After an error, go on from a snapshot.

    Args:
        training: Before it.
        environments: Stand where the last iteration left them.

    Raises:
        InvalidInput: An environment answered what is no step.
        FailedPrecondition: A metric is not finite.
        ServiceError: What else stepping the environments raises.
    """
    config, state = training.config, training.progress.state
    rollout, standing = collect(
        state.network,
        environments,
        training.standing,
        steps=config.steps,
        discount=config.discount,
        generator=state.generator,
    )
    progress, metrics = learn(training.progress, rollout, config)
    if len(rollout.returns):
        metrics["episode_return"] = rollout.returns.mean().item()
        metrics["episode_length"] = rollout.lengths.double().mean().item()
    _check_finite(metrics, training.iteration)
    return PPOTraining(config, progress, standing), metrics


def snapshot(training: PPOTraining, *, environments: bytes = b"") -> Checkpoint:
    """Returns a copy of a training, which nothing that follows changes; for `freerein.learning.checkpoints`, too.

    Args:
        training: Between two iterations.
        environments: How to bring these back to where they stand.
    """
    made = progresses.to_checkpoint(training.progress, _identity(training.config, training.network))
    tensors = {**made.tensors, **_to_tensors(training.standing), "environments": _from_bytes(environments)}
    return replace(made, tensors={name: tensor.detach().clone() for name, tensor in tensors.items()})


def restore(
    checkpoint: Checkpoint, config: PPOConfig, spec: ActorCriticSpec, *, device: torch.device
) -> tuple[PPOTraining, bytes]:
    """Returns the training that a snapshot is of, and how to bring its environments back.

    Args:
        checkpoint: From `snapshot`.
        config: As the training was begun with.
        spec: As well.
        device: As well.

    Raises:
        FailedPrecondition: The snapshot is of a training with another configuration, other networks, on another device
            or by another torch.
    """
    fresh = _untrained(config, spec, device)
    progress = progresses.from_checkpoint(checkpoint, fresh, _identity(config, fresh.state.network))
    environments = checkpoint.tensors["environments"].numpy().tobytes()
    return PPOTraining(config, progress, _from_tensors(checkpoint.tensors)), environments


def _untrained(config: PPOConfig, spec: ActorCriticSpec, device: torch.device) -> Progress[ActorCritic]:
    generator = torch.Generator().manual_seed(config.seed)
    network = ActorCritic(spec)
    weights.draw(network, generator=generator)
    network = network.to(device)
    optimiser = torch.optim.Adam(network.parameters(), config.learning_rate, eps=_EPSILON, fused=True)
    shuffle = Shuffle.begin(config.sequences, rng=np.random.default_rng(config.seed))
    return Progress(TrainingState(network, optimiser, generator), shuffle)


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
    return torch.cat([checked_observations(each, spec, environments.num_envs) for each in seen])


def _identity(config: PPOConfig, network: ActorCritic) -> dict[str, JSON]:
    device = next(network.parameters()).device
    return {
        "config": asdict(config),
        "network": asdict(network.spec),
        "torch": torch.__version__,
        "device": str(device),
    }


def _to_tensors(standing: Standing) -> dict[str, Tensor]:
    scale = standing.scale
    parts = {f"standing/{each.name}": getattr(standing, each.name) for each in fields(standing) if each.name != "scale"}
    return parts if scale is None else parts | {"scale/sums": scale.sums, "scale/moments": scale.moments}


def _from_tensors(tensors: Mapping[str, Tensor]) -> Standing:
    parts = {name.removeprefix("standing/"): each for name, each in tensors.items() if name.startswith("standing/")}
    is_scaled = "scale/sums" in tensors
    scale = RewardScale(tensors["scale/sums"], tensors["scale/moments"]) if is_scaled else None
    return Standing(**parts, scale=scale)


def _from_bytes(data: bytes) -> Tensor:
    return torch.from_numpy(np.frombuffer(data, np.uint8).copy())


def _check_finite(metrics: Mapping[str, float], iteration: int) -> None:
    for name, value in metrics.items():
        if not math.isfinite(value):
            raise FailedPrecondition(
                f"A training's metrics must stay finite; {name} is {value} in iteration {iteration}.",
                hint="Lower the learning rate, or look at the rewards.",
            )
