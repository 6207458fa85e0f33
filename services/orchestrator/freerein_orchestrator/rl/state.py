"""The complete state of a PPO training between two iterations, as a checkpoint and back, bit for bit.

No rollout is saved: the collector's state says where the next one starts, environments included.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from typing import TypeAlias, cast

import numpy as np
import torch
from torch import Tensor

from freerein.config import parse
from freerein.errors import InvalidInput
from freerein.learning import train_state
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.train_state import BatchSampler, FitLoopState, TrainState, tensors_under
from freerein_orchestrator.rl.config import PPOConfig, Schedule
from freerein_orchestrator.rl.episode_stats import EpisodeStats
from freerein_orchestrator.rl.initial_network import calibrate, init_network
from freerein_orchestrator.rl.object_encoder import explored_steps
from freerein_orchestrator.rl.return_normaliser import ReturnNormaliser
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import CollectorState
from freerein_orchestrator.rl.vec_env import VecEnv

_ADAM_EPSILON = 1e-5

Prepare: TypeAlias = Callable[[ActorCritic, VecEnv, torch.Generator], None]
"""Prepares a new network in its environments, drawing from a generator."""
MakeRewards: TypeAlias = Callable[[ActorCritic, Mapping[str, JSON]], Sequence[Reward]]
"""Returns the untrained rewards of a policy's network and of a training's inputs; those after the first are added."""


def env_rewards(_network: ActorCritic, _inputs: Mapping[str, JSON]) -> Sequence[Reward]:
    """Returns the reward that passes on what the environments return."""
    return (Reward(),)


@dataclass(frozen=True, eq=False)
class PPOState:
    """Everything that the next iteration depends on.

    Attributes:
        config: Hyperparameters.
        learner: Network, optimiser, optimiser steps, data order.
        collector: Where the next rollout starts.
        episodes: Statistics of the episodes under way.
        normaliser: Scales rewards; None without normalisation.
        rewards: Its reward functions; changed in place. Returns of episodes are of the first, the others are added.
        schedule: Where it is in the course of its learning rate and noise.
        inputs: Other inputs of the training, which must be the same when it is resumed.
        recorded: Trajectories recorded so far.
        metrics: Those of the last iteration.
    """

    config: PPOConfig
    learner: FitLoopState[ActorCritic]
    collector: CollectorState
    episodes: EpisodeStats
    normaliser: ReturnNormaliser | None
    rewards: Sequence[Reward]
    schedule: Schedule
    inputs: Mapping[str, JSON] = field(default_factory=dict)
    recorded: int = 0
    metrics: Mapping[str, float] = field(default_factory=dict)

    @property
    def network(self) -> ActorCritic:
        """The policy and its value, as trained so far."""
        return self.learner.state.network

    @property
    def iteration(self) -> int:
        """Completed iterations, without those of the trainings that it goes on with."""
        return self.learner.state.step // self.config.steps_per_iteration

    @property
    def timesteps(self) -> int:
        """Environment steps so far, those of exploration and of the trainings that it goes on with included."""
        iterations, spec = self.schedule.before + self.iteration, self.network.spec
        return (iterations * self.config.rollout_size + explored_steps(spec, self.config)) * spec.action_repeat


def init_state(
    config: PPOConfig,
    spec: ActorCriticSpec,
    envs: VecEnv,
    *,
    device: torch.device,
    prepare: Prepare = calibrate,
    make_rewards: MakeRewards = env_rewards,
    inputs: Mapping[str, JSON] | None = None,
) -> PPOState:
    """Returns the state before the first iteration; resets the environments.

    Args:
        config: Hyperparameters.
        spec: The network.
        envs: The environments.
        device: Where the network is trained.
        prepare: Prepares the new network: by default, calibrates its image encoder.
        make_rewards: Returns the rewards.
        inputs: Other inputs of the training, which must be the same.

    Raises:
        InvalidInput: The environments' number or observations are not the configuration's.
    """
    if envs.num_envs != config.num_envs:
        raise InvalidInput(
            f"There must be {config.num_envs} environments; got {envs.num_envs}.", field="config.num_envs"
        )
    learner = _init_learner(config, spec, device)
    network, generator = learner.state.network, learner.state.generator
    prepare(network, envs, generator)
    rewards = make_rewards(network, inputs or {})
    for reward in rewards:
        reward.begin()
    return PPOState(
        config=config,
        learner=learner,
        collector=CollectorState.init(envs, network, generator),
        episodes=EpisodeStats.init(config.num_envs),
        normaliser=ReturnNormaliser.init(config.num_envs) if config.normalise_rewards else None,
        rewards=rewards,
        schedule=Schedule(config.iterations),
        inputs=inputs or {},
    )


def to_checkpoint(state: PPOState) -> Checkpoint:
    """Returns a copy of a state, unaffected by what follows."""
    made = train_state.to_checkpoint(state.learner, _identity(state.config, state.network, state.inputs))
    rewards = {_reward_key(index): reward.snapshot() for index, reward in enumerate(state.rewards)}
    tensors = {
        **made.tensors,
        **{f"collector/{name}": tensor for name, tensor in _collector_tensors(state).items()},
        **{f"{key}/{name}": tensor for key, reward in rewards.items() for name, tensor in reward.tensors.items()},
    }
    document: dict[str, JSON] = {
        **made.document,
        "metrics": dict(state.metrics),
        "recorded": state.recorded,
        "schedule": asdict(state.schedule),
        **{key: {**reward.document, "step": reward.step} for key, reward in rewards.items()},
    }
    return replace(made, tensors={name: tensor.detach().clone() for name, tensor in tensors.items()}, document=document)


def from_checkpoint(
    checkpoint: Checkpoint,
    config: PPOConfig,
    *,
    device: torch.device,
    make_rewards: MakeRewards = env_rewards,
    inputs: Mapping[str, JSON] | None = None,
) -> PPOState:
    """Returns the state of a checkpoint.

    Args:
        checkpoint: From `to_checkpoint`.
        config: As the training was started with.
        device: The device that it was started on.
        make_rewards: The function that it was started with.
        inputs: Inputs to compare with the checkpoint's.

    Raises:
        FailedPrecondition: The training was started with another configuration or other inputs, on another device or
            with another torch version.
    """
    started = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    inputs = {**started["inputs"], **(inputs or {})}
    fresh = _init_learner(config, parse(ActorCriticSpec, started["network"]), device)
    identity = _identity(config, fresh.state.network, inputs)
    identity["network"] = dict(started["network"])  # an earlier version's has fewer keys
    learner = train_state.from_checkpoint(checkpoint, fresh, identity, defaults=_defaults(config))
    return _restored(checkpoint, config, learner, make_rewards, inputs)


def trained_on(
    checkpoint: Checkpoint,
    config: PPOConfig,
    *,
    device: torch.device,
    make_rewards: MakeRewards = env_rewards,
) -> PPOState:
    """Returns the state before the first iteration of a training that goes on with that of a checkpoint.

    It has all of the checkpoint's state: network, optimiser, normaliser, schedule, environments, generators.

    Args:
        checkpoint: From `to_checkpoint`.
        config: Of the new training; `iterations` are its own. What shapes the state must be as in the checkpoint's.
        device: The device of the new training.
        make_rewards: The function that the earlier training was started with.
    """
    started = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    fresh = _init_learner(config, parse(ActorCriticSpec, started["network"]), device)
    identity = cast(Mapping[str, JSON], started)  # whichever torch it was trained with
    learner = train_state.from_checkpoint(checkpoint, fresh, identity)
    state = _restored(checkpoint, config, learner, make_rewards, started["inputs"])
    schedule = replace(state.schedule, before=state.schedule.before + state.iteration)
    return replace(state, learner=replace(learner, state=replace(learner.state, step=0)), schedule=schedule)


def _restored(
    checkpoint: Checkpoint,
    config: PPOConfig,
    learner: FitLoopState[ActorCritic],
    make_rewards: MakeRewards,
    inputs: Mapping[str, JSON],
) -> PPOState:
    """Returns the state of a checkpoint whose learner is restored."""
    rewards = make_rewards(learner.state.network, inputs)
    for index, reward in enumerate(rewards):
        if saved := cast(dict[str, JSON], checkpoint.document.get(_reward_key(index))):  # before, one alone had a state
            tensors = tensors_under(f"{_reward_key(index)}/", checkpoint.tensors)
            reward.restore(Checkpoint(cast(int, saved["step"]), tensors, saved))
    collector = tensors_under("collector/", checkpoint.tensors)
    normaliser = ReturnNormaliser(collector["discounted"], collector["moments"]) if "moments" in collector else None
    snapshots = [collector[f"env/{index}"] for index in range(len(tensors_under("env/", collector)))]
    return PPOState(
        config=config,
        learner=learner,
        collector=CollectorState(
            observations=collector["observations"],
            episode_starts=collector["episode_starts"],
            recurrent_state=collector["recurrent_state"],
            generator=collector["generator"],
            env_snapshots=tuple(each.numpy().tobytes() for each in snapshots),
        ),
        episodes=EpisodeStats(collector["returns"], collector["lengths"]),
        normaliser=normaliser,
        rewards=rewards,
        schedule=_schedule(checkpoint),
        inputs=inputs,
        recorded=cast(int, checkpoint.document["recorded"]),
        metrics=cast(Mapping[str, float], checkpoint.document["metrics"]),
    )


def _init_learner(config: PPOConfig, spec: ActorCriticSpec, device: torch.device) -> FitLoopState[ActorCritic]:
    generator = torch.Generator().manual_seed(config.seed)
    network = init_network(spec, generator).to(device)
    if network.gaussian is not None:
        network.gaussian.log_std.requires_grad_(config.final_log_std is None)
    trainable = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimiser = torch.optim.Adam(trainable, config.lr, eps=_ADAM_EPSILON, fused=True)
    sequences = config.rollout_size // config.sequence_length
    sampler = BatchSampler.start(sequences, rng=np.random.default_rng(config.seed))
    return FitLoopState(TrainState(network, optimiser, generator), sampler)


def _reward_key(index: int) -> str:
    """Returns the name of a reward's state in a checkpoint."""
    return f"reward{index or ''}"


def _schedule(checkpoint: Checkpoint) -> Schedule:
    """Returns the schedule of a checkpoint; earlier versions had none but that of the configuration."""
    started = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    own = {"iterations": started["config"]["iterations"]}
    return Schedule(**cast(dict[str, int], checkpoint.document.get("schedule", own)))


def _defaults(config: PPOConfig) -> dict[str, JSON]:
    """Returns the defaults of a configuration's keys, for checkpoints of versions that did not have them all."""
    defaults = {each.name: each.default for each in fields(config) if each.default is not MISSING}
    return cast(dict[str, JSON], json.loads(json.dumps(defaults)))


def _identity(config: PPOConfig, network: ActorCritic, inputs: Mapping[str, JSON]) -> dict[str, JSON]:
    return {
        "config": json.loads(json.dumps(asdict(config))),  # tuples as the lists that a checkpoint holds
        "network": asdict(network.spec),
        "torch": torch.__version__,
        "device": str(next(network.parameters()).device),
        "inputs": dict(inputs),
    }


def _collector_tensors(state: PPOState) -> dict[str, Tensor]:
    collector, normaliser = state.collector, state.normaliser
    tensors = {
        "observations": collector.observations,
        "episode_starts": collector.episode_starts,
        "recurrent_state": collector.recurrent_state,
        "generator": collector.generator,
        "returns": state.episodes.returns,
        "lengths": state.episodes.lengths,
    }
    if normaliser is not None:
        tensors |= {"discounted": normaliser.returns, "moments": normaliser.moments}
    for index, snapshot in enumerate(collector.env_snapshots):
        tensors[f"env/{index}"] = torch.from_numpy(np.frombuffer(snapshot, np.uint8).copy())
    return tensors
