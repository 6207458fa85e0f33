"""Steps per second of PPO over the network, beside the same PPO in one process, and with two sims beside one.

Each turn is a short training from the same checkpoint, with the same worlds and learned reward; equal final weights are
checked. In one process the actor and the learner have a thread each, as over the network.
"""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks.report import Bar, Ratio, Results
from benchmarks.servers import run_service
from benchmarks.timing import Effort, Workload, measure_rates, repeat
from freerein.clients import Channel, RewardClient, SimClient, Synchronous
from freerein.learning import weights
from freerein.learning.checkpoints import Checkpoint
from freerein.serving.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ModelRef
from freerein.types.sim import CreateSessionRequest
from freerein_orchestrator import ppo_training
from freerein_orchestrator.judges import Frames, LearnedReward
from freerein_orchestrator.networks import ActorCritic
from freerein_orchestrator.patience import Patience
from freerein_orchestrator.ppo_config import PPOConfig
from freerein_orchestrator.ppo_loop import Gather, iterations
from freerein_orchestrator.ppo_training import Outset, roll_out
from freerein_orchestrator.rollout import Actions, Observations, Rewards, Rollout, Step
from freerein_orchestrator.served import ServedEnvironments
from freerein_orchestrator.served_rollouts import ServedRollouts
from freerein_reward.core import GoalCache, Inference, RewardModel
from freerein_reward.core.inference import ScoreItem, Scores
from freerein_reward.model import trained
from freerein_reward.relations import rivals
from freerein_sim.workers.envs import Envs
from freerein_sim.worlds.tasks import tasks

_TASK, _CAMERA, _FRAME = "blocks.yellow-left-of-green", "front", (64, 64, 3)
_CONFIG = PPOConfig(iterations=3)
_STEPS = _CONFIG.iterations * _CONFIG.num_envs * _CONFIG.steps
_ROUNDS = 3
_CPU = torch.device("cpu")
_CACHE_BYTES = 2**20
_JUDGED_TOGETHER = 32

Train = Callable[[], str]
"""Trains once; returns the sha256 of the final weights."""


async def measure(effort: Effort) -> Results:
    """Returns the relative speed of PPO over the network and in process."""
    async with AsyncExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()))
        sims: list[Synchronous] = []
        for name in ("one", "two"):
            stack = await opened.enter_async_context(
                run_service("sim", data_dir=folder / name, FREEREIN_SIM_WORKERS="1")
            )
            sims.append(opened.enter_context(Synchronous(SimClient(Channel(stack.addresses["sim"])))))
        stack = await opened.enter_async_context(run_service("reward", data_dir=folder / "reward"))
        reward = opened.enter_context(Synchronous(RewardClient(Channel(stack.addresses["reward"]))))
        return await _measure(sims, reward, replace(effort, rounds=min(effort.rounds, _ROUNDS)))


async def _measure(sims: Sequence[Synchronous], reward: Synchronous, effort: Effort) -> Results:
    one, two = [await asyncio.to_thread(_Served.begin, sims[:count], reward) for count in (1, 2)]
    with closing(_Local(one.begun)) as local:
        trainings = {"in-process": local.train, "one-sim": one.train, "two-sims": two.train}
        ends: dict[str, str] = {}
        times = await measure_rates([_workload(name, train, ends) for name, train in trainings.items()], effort)
    if ends["in-process"] != ends["one-sim"]:
        raise RuntimeError("Over the network and in process the final weights must be equal; they differ.")
    return Results(
        ratios=(
            Ratio("ppo.network_vs_in_process", times.speedup("one-sim", over="in-process"), Bar("at least", 0.8)),
            Ratio("ppo.two_sims_vs_one", times.speedup("two-sims", over="one-sim")),
        ),
        rates={"ppo": times},
    )


def _workload(name: str, train: Train, ends: dict[str, str]) -> Workload:
    """Returns a workload that records its final weights' hash in `ends`."""

    async def call() -> None:
        ends[name] = await asyncio.to_thread(train)

    return Workload(name, repeat(call), _STEPS, "steps")


def _train(begun: Checkpoint, gather: Gather) -> str:
    *_, last = iterations(ppo_training.restore(begun, _CONFIG, device=_CPU), gather)
    return weights.sha256(last.network)


@dataclass(frozen=True)
class _Served:
    """Trains with services."""

    sims: Sequence[Synchronous]
    reward: Synchronous
    begun: Checkpoint

    @classmethod
    def begin(cls, sims: Sequence[Synchronous], reward: Synchronous) -> "_Served":
        spec = ppo_training.design(_CONFIG, observation=_FRAME, action_size=tasks()[_TASK].spec.action.size)
        with closing(_open(sims, reward, ())) as environments:
            begun = ppo_training.begin(_CONFIG, spec, environments, device=_CPU)
        return cls(sims, reward, ppo_training.snapshot(begun))

    def train(self) -> str:
        patience = Patience(np.random.default_rng(), stop=lambda: False, say=lambda _: None)
        with closing(ServedRollouts(lambda at: _open(self.sims, self.reward, at), _CONFIG, patience)) as rollouts:
            return _train(self.begun, rollouts.gather)


def _open(sims: Sequence[Synchronous], reward: Synchronous, snapshots: Sequence[bytes]) -> ServedEnvironments:
    request = CreateSessionRequest(_TASK, num_envs=_CONFIG.num_envs, seed=0)
    judge = LearnedReward(reward, tasks()[_TASK].goal_text, _CAMERA)
    return ServedEnvironments(sims, request, camera=_CAMERA, judge=judge, snapshots=snapshots)


class _Local:
    """Trains in this process, with the worlds and the reward model of the services.

    The worlds have their own thread, since a GL context belongs to one thread.
    """

    num_envs = _CONFIG.num_envs

    def __init__(self, begun: Checkpoint) -> None:
        self._begun = begun
        self._judge = _Judge(tasks()[_TASK].goal_text)
        self._thread = ThreadPoolExecutor(1, "worlds")
        self._envs = self._thread.submit(Envs, tasks()[_TASK], num_envs=self.num_envs, seed=0).result()
        self._at = b""
        self._waiting: list[Frames] = []
        self._judged: list[Rewards] = []

    def train(self) -> str:
        return _train(self._begun, self._gather)

    def _gather(self, actor: ActorCritic, outset: Outset) -> tuple[Rollout, Outset]:
        if outset.environments != (self._at,):
            self._thread.submit(self._envs.restore, outset.environments[0]).result()
        return roll_out(actor, outset, self, _CONFIG)

    def reset(self) -> Observations:
        return self._thread.submit(self._envs.reset, cameras=(_CAMERA,)).result().frames[_CAMERA]

    def step(self, actions: Actions) -> Step:
        reply = self._thread.submit(self._envs.step, actions, (_CAMERA,)).result()
        reached, over = reply.frames[_CAMERA].copy(), reply.terminated | reply.truncated
        reached[over] = reply.final_frames[_CAMERA]
        self._waiting.append(reached)
        if len(self._waiting) * self.num_envs == _JUDGED_TOGETHER:
            self._judged.append(self._judge(np.concatenate(self._waiting)))
            self._waiting = []
        return Step(reply.frames[_CAMERA], reply.terminated, reply.truncated, reached)

    def rewards(self) -> Rewards:
        judged, self._judged = self._judged, []
        return np.concatenate(judged).reshape(-1, self.num_envs)

    def snapshots(self) -> tuple[bytes, ...]:
        self._at = self._thread.submit(self._envs.snapshot).result()
        return (self._at,)

    def close(self) -> None:
        self._thread.submit(self._envs.close).result()
        self._thread.shutdown()


class _Judge:
    """The reward service's default model."""

    def __init__(self, goal_text: str) -> None:
        store = ModelStore(CLONE_MODELS / "reward")
        self._ref = ModelRef("default", store.active_version("default"))
        model, _ = trained.load(store.folder(self._ref), "cpu")
        if not isinstance(model, RewardModel):
            raise TypeError("The default model of the reward service must be a reward model.")
        self._model = model
        self._texts = (goal_text, *rivals(goal_text))
        self._inference = Inference(GoalCache(_CACHE_BYTES))

    def __call__(self, reached: Frames) -> Rewards:
        item = ScoreItem(self._ref, self._model, self._texts, {_CAMERA: reached})
        (scores,) = self._inference.run([item])
        if not isinstance(scores, Scores):
            raise TypeError("Frames of the world must have scores.")
        goal, others = scores.similarities[:, 0], scores.similarities[:, 1:]
        rewards: Rewards = (goal > others.max(axis=1)).astype(np.float32)
        return rewards
