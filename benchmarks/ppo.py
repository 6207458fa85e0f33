"""Control ticks per second of PPO over the network, beside the same PPO in one process.

One more training holds each action for two ticks, as PPO does unless told otherwise; the others hold none.

Each turn is a short training from the same checkpoint, with the same worlds and learned reward; equal final weights are
checked. In one process the worlds and the reward model have a thread each.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AsyncExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks.report import Ratio, Results
from benchmarks.servers import run_service
from benchmarks.timing import Effort, Workload, measure_rates, repeat
from freerein.clients import Channel, RewardClient, SimClient, SyncClient
from freerein.goal_text import rival_captions
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCritic
from freerein.learning.checkpoints import Checkpoint
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import Camera, ModelRef
from freerein.types.sim import CreateSessionRequest
from freerein_orchestrator.envs.recovery import RecoveringCollector
from freerein_orchestrator.envs.retry import Retry
from freerein_orchestrator.envs.vector_env import FRAMES_PER_REWARD_CALL, RemoteVectorEnv, RewardFn, open_groups
from freerein_orchestrator.rewards.learned import LearnedReward
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.env_groups import EnvGroups, collect_groups
from freerein_orchestrator.rl.initial_network import network_spec
from freerein_orchestrator.rl.object_encoder import fit_object_encoder, load_reward_encoder
from freerein_orchestrator.rl.reward import Reward
from freerein_orchestrator.rl.rollout import Collector, CollectorState, RolloutBuffer
from freerein_orchestrator.rl.state import PPOState, from_checkpoint, init_state, to_checkpoint
from freerein_orchestrator.rl.trainer import Trainer
from freerein_orchestrator.rl.vec_env import Actions, Frames, Observations, Rewards, VecStep
from freerein_reward.core import GoalCache, Inference, RewardModel
from freerein_reward.core.inference import ScoreItem, Scores
from freerein_reward.methods import load
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks

_TASK, _CAMERA, _FRAME = "blocks.yellow-left-of-green", "front", (64, 64, 3)
_MINIBATCH_ENVS = 8
_ROUNDS = 3
_HELD = 2
_CPU = torch.device("cpu")
_CACHE_BYTES = 2**20

Train = Callable[[], str]
"""Trains once; returns the sha256 of the final weights."""


async def measure(effort: Effort) -> Results:
    """Returns the relative speed of PPO over the network and in process."""
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        stack = await opened.enter_async_context(run_service("sim", data_dir=folder / "sim", FREEREIN_SIM_WORKERS="1"))
        sim = opened.enter_context(SyncClient(SimClient(Channel(stack.addresses["sim"]))))
        stack = await opened.enter_async_context(run_service("reward", data_dir=folder / "reward"))
        reward = opened.enter_context(SyncClient(RewardClient(Channel(stack.addresses["reward"]))))
        return await _measure(sim, reward, replace(effort, rounds=min(effort.rounds, _ROUNDS)))


async def _measure(sim: SyncClient, reward: SyncClient, effort: Effort) -> Results:
    config = PPOConfig(
        iterations=effort.iterations,
        num_steps=effort.num_steps,
        batch_size=_MINIBATCH_ENVS * effort.num_steps,
        explorations=1,
    )
    one, held = [
        await asyncio.to_thread(_Served.init, config, sim, reward, action_repeat=count) for count in (1, _HELD)
    ]
    local = _Local(config, one.start)
    try:
        trainings = {"in-process": local.train, "one-sim": one.train, "held": held.train}
        ends: dict[str, str] = {}
        steps = config.iterations * config.rollout_size
        ticks = {name: steps * (_HELD if name == "held" else 1) for name in trainings}
        times = await measure_rates(
            [_workload(name, train, ticks[name], ends) for name, train in trainings.items()], effort
        )
    finally:
        local.end()
    if ends["in-process"] != ends["one-sim"]:
        raise RuntimeError("Over the network and in process the final weights must be equal; they differ.")
    return Results(
        ratios=(Ratio("ppo.network_vs_in_process", times.speedup("one-sim", over="in-process"), at_least=0.8),),
        rates={"ppo": times},
    )


def _workload(name: str, train: Train, ticks: int, ends: dict[str, str]) -> Workload:
    """Returns a workload of so many control ticks that records its final weights' hash in `ends`."""

    async def call() -> None:
        ends[name] = await asyncio.to_thread(train)

    return Workload(name, repeat(call), ticks, "ticks")


class _NoLog:
    """Drops metrics."""

    def append(self, step: int, metrics: Mapping[str, float]) -> None:
        """Drops a row."""

    def close(self) -> None:
        """Holds nothing."""


def _train(config: PPOConfig, start: Checkpoint, collector: Collector) -> str:
    """Trains from a checkpoint; returns the sha256 of the final weights."""
    with TemporaryDirectory() as folder:
        state = Trainer(
            Path(folder),
            init=lambda: from_checkpoint(start, config, device=_CPU),
            load=lambda checkpoint: from_checkpoint(checkpoint, config, device=_CPU),
            collector=lambda _: collector,
            metrics_log=lambda _: _NoLog(),
        ).train()
    return weights.sha256(state.network)


@dataclass(frozen=True)
class _Served:
    """Trains with services."""

    config: PPOConfig
    sim: SyncClient
    reward: SyncClient
    start: Checkpoint
    action_repeat: int

    @classmethod
    def init(cls, config: PPOConfig, sim: SyncClient, reward: SyncClient, *, action_repeat: int) -> "_Served":
        task, camera = tasks()[_TASK], Camera(_CAMERA, *_FRAME)
        encoder = load_reward_encoder(_reward_folder(), goal_caption=task.goal_text, camera=camera)
        spec = network_spec(
            config,
            observation=_FRAME,
            action_size=task.spec.action.size,
            object_encoder=encoder.spec,
            action_repeat=action_repeat,
        )
        with closing(_open(config, sim, Reward().of_frames, (), action_repeat)) as envs:
            state: PPOState = init_state(
                config,
                spec,
                envs,
                device=_CPU,
                prepare=partial(
                    fit_object_encoder,
                    objects=encoder.weights,
                    explorations=config.explorations,
                    augmentation=config.augmentation,
                ),
            )
        return cls(config, sim, reward, to_checkpoint(state), action_repeat)

    def train(self) -> str:
        retry = Retry(np.random.default_rng(), stop=lambda: False, tell=lambda _: None)
        reward_fn = LearnedReward(self.reward, tasks()[_TASK].goal_text).of_frames
        collector = RecoveringCollector(
            lambda snapshots: _open(self.config, self.sim, reward_fn, snapshots, self.action_repeat),
            num_steps=self.config.num_steps,
            retry=retry,
        )
        return _train(self.config, self.start, collector)


def _open(
    config: PPOConfig,
    sim: SyncClient,
    reward_fn: RewardFn,
    snapshots: Sequence[bytes],
    action_repeat: int,
) -> EnvGroups[RemoteVectorEnv]:
    request = CreateSessionRequest(_TASK, num_envs=config.num_envs, seed=0)
    return open_groups(
        [sim], request, cameras=(_CAMERA,), reward_fn=reward_fn, action_repeat=action_repeat, snapshots=snapshots
    )


class _Local:
    """Trains in this process, with the worlds and the reward model of the services; a `Collector`."""

    recoveries = 0

    def __init__(self, config: PPOConfig, start: Checkpoint) -> None:
        self._config = config
        self._start = start
        reward_fn = _LocalReward(tasks()[_TASK].goal_text)
        self._reward_thread = ThreadPoolExecutor(1, "reward")
        shares = [config.num_envs - config.num_envs // 2, config.num_envs // 2]
        self._envs = EnvGroups([_LocalGroup(share, reward_fn, self._reward_thread) for share in shares])

    def train(self) -> str:
        return _train(self._config, self._start, self)

    def collect(self, network: ActorCritic, state: CollectorState) -> tuple[RolloutBuffer, CollectorState]:
        for group, snapshot in zip(self._envs.groups, state.env_snapshots, strict=True):
            group.restore(snapshot)
        return collect_groups(network, self._envs, state, num_steps=self._config.num_steps)

    def close(self) -> None:
        """Keeps the worlds for the next training."""

    def end(self) -> None:
        """Closes the worlds."""
        self._envs.close()
        self._reward_thread.shutdown()


class _LocalGroup:
    """Worlds in this process, on a thread of their own, since a GL context belongs to one thread; a `VecEnv`.

    The reward model has a thread that all groups share, as over the network.
    """

    def __init__(self, num_envs: int, reward_fn: "_LocalReward", reward_thread: ThreadPoolExecutor) -> None:
        self.num_envs = num_envs
        self._reward_fn = reward_fn
        self._reward_thread = reward_thread
        self._thread = ThreadPoolExecutor(1, "worlds")
        self._envs = self._thread.submit(VectorEnv, tasks()[_TASK], num_envs=num_envs, seed=0).result()
        self._snapshot = b""
        self._pending: list[Frames] = []
        self._rewards: list[Future[Rewards]] = []

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot, unless the worlds are where it was taken."""
        if snapshot != self._snapshot:
            self._thread.submit(self._envs.restore, snapshot).result()

    def reset(self) -> Observations:
        return self._thread.submit(self._envs.reset, cameras=(_CAMERA,)).result().frames[_CAMERA]

    def step(self, actions: Actions) -> VecStep:
        reply = self._thread.submit(self._envs.step, actions, (_CAMERA,)).result()
        final, done = reply.frames[_CAMERA].copy(), reply.terminated | reply.truncated
        final[done] = reply.final_frames[_CAMERA]
        self._pending.append(final)
        if len(self._pending) * self.num_envs == FRAMES_PER_REWARD_CALL:
            self._rewards.append(self._reward_thread.submit(self._reward_fn, np.concatenate(self._pending)))
            self._pending = []
        return VecStep(reply.frames[_CAMERA], reply.terminated, reply.truncated, final)

    def rewards(self) -> Rewards:
        futures, self._rewards = self._rewards, []
        return np.concatenate([future.result() for future in futures]).reshape(-1, self.num_envs)

    def snapshots(self) -> tuple[bytes, ...]:
        self._snapshot = self._thread.submit(self._envs.snapshot).result()
        return (self._snapshot,)

    def close(self) -> None:
        """Closes the worlds."""
        self._thread.submit(self._envs.close).result()
        self._thread.shutdown()


def _reward_folder() -> Path:
    store = ModelStore(CLONE_MODELS / "reward")
    return store.folder(ModelRef("default", store.active_version("default")))


class _LocalReward:
    """The reward service's default model."""

    def __init__(self, goal_text: str) -> None:
        folder = _reward_folder()
        self._ref = ModelRef("default", folder.name)
        model = load(folder, "cpu")
        if not isinstance(model, RewardModel):
            raise TypeError("The default model of the reward service must be a reward model.")
        self._model = model
        self._texts = (goal_text, *rival_captions(goal_text))
        self._inference = Inference(GoalCache(_CACHE_BYTES))

    def __call__(self, frames: Frames) -> Rewards:
        item = ScoreItem(self._ref, self._model, self._texts, {_CAMERA: frames})
        (scores,) = self._inference.run([item])
        if not isinstance(scores, Scores):
            raise TypeError("Frames of the world must have scores.")
        goal, others = scores.similarities[:, 0], scores.similarities[:, 1:]
        rewards: Rewards = (goal > others.max(axis=1)).astype(np.float32)
        return rewards
