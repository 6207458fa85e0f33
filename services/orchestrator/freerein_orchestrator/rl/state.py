"""The complete state of a PPO training between two iterations, as a checkpoint and back, bit for bit.

No rollout is saved: the collector's state says where the next one starts, environments included.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from typing import TypeAlias, cast

import numpy as np
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import train_state, weights
from freerein.learning.actor_critic.body import Exploration
from freerein.learning.actor_critic.eye import EyeSpec
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.checkpoints import JSON, Checkpoint
from freerein.learning.config import parse
from freerein.learning.train_state import BatchSampler, FitLoopState, TrainState, tensors_under
from freerein_orchestrator.rl.config import PPOConfig, Schedule
from freerein_orchestrator.rl.episode_stats import EpisodeStats
from freerein_orchestrator.rl.return_normaliser import ReturnNormaliser
from freerein_orchestrator.rl.rewards import EnvRewards, RewardLearner
from freerein_orchestrator.rl.rollout import CollectorState
from freerein_orchestrator.rl.vec_env import Observations, VecEnv, env_actions, observation_tensor

_CALIBRATION_STEPS = 64
_EXPLORATION_STEPS, _EXPLORATION_RANGE = 8, 0.5
_ADAM_EPSILON = 1e-5

MakeRewardLearner: TypeAlias = Callable[[ActorCritic], RewardLearner]
"""Returns the untrained reward learner of a policy network."""


def env_rewards(_network: ActorCritic) -> RewardLearner:
    """Returns the reward learner that passes the environments' rewards on."""
    return EnvRewards()


@dataclass(frozen=True, eq=False)
class PPOState:
    """Everything that the next iteration depends on.

    Attributes:
        config: Hyperparameters.
        learner: Network, optimiser, optimiser steps, data order.
        collector: Where the next rollout starts.
        episodes: Statistics of the episodes under way.
        normaliser: Scales rewards; None without normalisation.
        reward_learner: Rewards rollouts; changed in place.
        schedule: Where it is in the course of its learning rate and noise.
        inputs: What else the training was started with and must be resumed with.
        recorded: Trajectories recorded so far.
        metrics: Those of the last iteration.
    """

    config: PPOConfig
    learner: FitLoopState[ActorCritic]
    collector: CollectorState
    episodes: EpisodeStats
    normaliser: ReturnNormaliser | None
    reward_learner: RewardLearner
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
        explorations = 0 if self.network.eye is None else self.config.explorations
        explored = explorations * _EXPLORATION_STEPS * self.config.num_envs
        iterations = self.schedule.before + self.iteration
        return (iterations * self.config.rollout_size + explored) * self.network.spec.action_repeat


def network_spec(
    config: PPOConfig,
    *,
    observation: tuple[int, ...],
    action_size: int = 1,
    action_choices: int = 0,
    eye: EyeSpec | None = None,
    action_repeat: int = 1,
) -> ActorCriticSpec:
    """Returns the network of a configuration.

    Args:
        config: Hyperparameters.
        observation: Shape of an observation: (H, W, C) or (D,).
        action_size: Numbers per action.
        action_choices: Number of discrete actions, 0 if continuous.
        eye: The frozen eye that sees the frames, if any.
        action_repeat: Timesteps that each action is held for.

    Raises:
        InvalidInput: There is no network for such observations or actions.
    """
    match observation:
        case (height, width, channels):
            shape = {"height": height, "width": width, "channels": channels}
        case (size,):
            shape = {"vector_size": size}
        case _:
            raise InvalidInput(f"An observation must have the shape (H, W, C) or (D,); got {observation}.")
    return ActorCriticSpec(
        **shape,
        action_size=action_size,
        action_choices=action_choices,
        feature_size=config.feature_size,
        hidden_size=config.hidden_size,
        recurrent=config.recurrent,
        init_log_std=config.init_log_std,
        layer_norm=config.layer_norm,
        eye=eye,
        action_repeat=action_repeat,
    )


def init_state(
    config: PPOConfig,
    spec: ActorCriticSpec,
    envs: VecEnv,
    *,
    device: torch.device,
    init_from: ActorCritic | None = None,
    object_encoder: Mapping[str, Tensor] | None = None,
    make_reward_learner: MakeRewardLearner = env_rewards,
    inputs: Mapping[str, JSON] | None = None,
) -> PPOState:
    """Returns the state before the first iteration; resets the environments.

    The image encoder of new weights is calibrated on the frames that random actions lead to; an eye is fitted to them.

    Args:
        config: Hyperparameters.
        spec: The network.
        envs: The environments.
        device: Where the network is trained.
        init_from: A network of the same spec to copy.
        object_encoder: Weights of the eye's encoder of objects; needed by a network with an eye that is not copied.
        make_reward_learner: Returns the reward learner.
        inputs: What else the training must be resumed with.

    Raises:
        InvalidInput: The environments' number or observations are not the configuration's.
    """
    if envs.num_envs != config.num_envs:
        raise InvalidInput(
            f"There must be {config.num_envs} environments; got {envs.num_envs}.", field="config.num_envs"
        )
    learner = _init_learner(config, spec, device)
    network, generator = learner.state.network, learner.state.generator
    if init_from is not None:
        network.load_state_dict(init_from.state_dict())
    elif network.eye is not None:
        network.eye.load_objects(object_encoder or {})
        network.eye.fit(explore(network.spec, envs, generator, count=config.explorations), generator)
    else:
        calibrate(network, envs, generator)
    return PPOState(
        config=config,
        learner=learner,
        collector=CollectorState.init(envs, network, generator),
        episodes=EpisodeStats.init(config.num_envs),
        normaliser=ReturnNormaliser.init(config.num_envs) if config.normalise_rewards else None,
        reward_learner=make_reward_learner(network),
        schedule=Schedule(config.iterations),
        inputs=inputs or {},
    )


def init_network(spec: ActorCriticSpec, generator: torch.Generator) -> ActorCritic:
    """Returns a network with initial weights, not yet calibrated."""
    network = ActorCritic(spec)
    weights.initialise(network, generator=generator)
    return network


def calibrate(network: ActorCritic, envs: VecEnv, generator: torch.Generator) -> None:
    """Calibrates a network's image encoder on frames that random actions lead to; does nothing for vectors."""
    spec = network.spec
    if spec.vector_size:
        return
    frames: list[Observations] = [envs.reset()]
    for _ in range(_CALIBRATION_STEPS):
        frames.append(envs.step(env_actions(_random_actions(spec, envs.num_envs, generator))).observations)
    envs.rewards()  # unused
    seen = torch.cat([observation_tensor(each, spec, envs.num_envs) for each in frames])
    network.calibrate(seen.to(next(network.parameters()).device))


def explore(spec: ActorCriticSpec, envs: VecEnv, generator: torch.Generator, *, count: int) -> Exploration:
    """Returns `count` short sequences of small random actions in each environment, from the starts of episodes.

    Those in which an episode ended are left out.
    """
    sequences, moves = [], []
    for _ in range(count):
        frames = [observation_tensor(envs.reset(), spec, envs.num_envs)]
        actions, has_ended = [], torch.zeros(envs.num_envs, dtype=torch.bool)
        for _ in range(_EXPLORATION_STEPS):
            actions.append(_EXPLORATION_RANGE * _random_actions(spec, envs.num_envs, generator))
            step = envs.step(env_actions(actions[-1]))
            frames.append(observation_tensor(step.observations, spec, envs.num_envs))
            has_ended |= torch.from_numpy(step.terminated | step.truncated)
        sequences.append(torch.stack(frames, dim=1)[~has_ended])
        moves.append(torch.stack(actions, dim=1)[~has_ended])
    envs.rewards()  # unused
    return Exploration(torch.cat(sequences), torch.cat(moves))


def _random_actions(spec: ActorCriticSpec, num_envs: int, generator: torch.Generator) -> Tensor:
    """Returns uniform actions, (num_envs, A)."""
    size = num_envs, spec.action_size
    if spec.action_choices:
        return torch.randint(spec.action_choices, size, generator=generator)
    return 2 * torch.rand(size, generator=generator) - 1


def to_checkpoint(state: PPOState) -> Checkpoint:
    """Returns a copy of a state, unaffected by what follows."""
    made = train_state.to_checkpoint(state.learner, _identity(state.config, state.network, state.inputs))
    reward = state.reward_learner.snapshot()
    tensors = {
        **made.tensors,
        **{f"collector/{name}": tensor for name, tensor in _collector_tensors(state).items()},
        **{f"reward/{name}": tensor for name, tensor in reward.tensors.items()},
    }
    document: dict[str, JSON] = {
        **made.document,
        "metrics": dict(state.metrics),
        "recorded": state.recorded,
        "schedule": asdict(state.schedule),
        "reward": {**reward.document, "step": reward.step},
    }
    return replace(made, tensors={name: tensor.detach().clone() for name, tensor in tensors.items()}, document=document)


def from_checkpoint(
    checkpoint: Checkpoint,
    config: PPOConfig,
    *,
    device: torch.device,
    make_reward_learner: MakeRewardLearner = env_rewards,
    inputs: Mapping[str, JSON] | None = None,
) -> PPOState:
    """Returns the state of a checkpoint.

    Args:
        checkpoint: From `to_checkpoint`.
        config: As the training was started with.
        device: The device that it was started on.
        make_reward_learner: The function that it was started with.
        inputs: Inputs to compare with the checkpoint's.

    Raises:
        FailedPrecondition: The training was started with another configuration or other inputs, on another device or
            with another torch version.
    """
    started = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    inputs = {**started["inputs"], **(inputs or {})}
    fresh = _init_learner(config, parse(ActorCriticSpec, started["network"]), device)
    identity = _identity(config, fresh.state.network, inputs)
    learner = train_state.from_checkpoint(checkpoint, fresh, identity, defaults=_defaults(config))
    return _restored(checkpoint, config, learner, make_reward_learner, inputs)


def trained_on(
    checkpoint: Checkpoint,
    config: PPOConfig,
    *,
    device: torch.device,
    make_reward_learner: MakeRewardLearner = env_rewards,
    inputs: Mapping[str, JSON] | None = None,
) -> PPOState:
    """Returns the state before the first iteration of a training that goes on with that of a checkpoint.

    It has all of the checkpoint's state: network, optimiser, normaliser, schedule, environments, generators.

    Args:
        checkpoint: From `to_checkpoint`.
        config: Of the new training; `iterations` are its own. What shapes the state must be as in the checkpoint's.
        device: The device of the new training.
        make_reward_learner: The function that the earlier training was started with.
        inputs: Inputs that the new training must be resumed with besides those of the checkpoint.
    """
    started = cast(Mapping[str, Mapping[str, JSON]], checkpoint.document["identity"])
    fresh = _init_learner(config, parse(ActorCriticSpec, started["network"]), device)
    identity = cast(Mapping[str, JSON], started)  # whichever torch it was trained with
    learner = train_state.from_checkpoint(checkpoint, fresh, identity)
    state = _restored(checkpoint, config, learner, make_reward_learner, {**started["inputs"], **(inputs or {})})
    schedule = replace(state.schedule, before=state.schedule.before + state.iteration)
    return replace(state, learner=replace(learner, state=replace(learner.state, step=0)), schedule=schedule)


def _restored(
    checkpoint: Checkpoint,
    config: PPOConfig,
    learner: FitLoopState[ActorCritic],
    make_reward_learner: MakeRewardLearner,
    inputs: Mapping[str, JSON],
) -> PPOState:
    """Returns the state of a checkpoint whose learner is restored."""
    reward_learner = make_reward_learner(learner.state.network)
    reward = cast(dict[str, JSON], checkpoint.document["reward"])
    tensors = tensors_under("reward/", checkpoint.tensors)
    reward_learner.restore(Checkpoint(cast(int, reward["step"]), tensors, reward))
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
        reward_learner=reward_learner,
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
