"""Steps per second of the sim service, over the network and in process, beside Gymnasium's `SyncVectorEnv`.

All step the same worlds with random actions. The service has one worker process, so that it has no more cores than the
others. Each network call is sent after the reply to the last, except for the sixteen calls of `16-unary`.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import dataclass, field
from functools import partial
from itertools import count, cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from benchmarks.report import Ratio, Results
from benchmarks.servers import exchange, run_service
from benchmarks.timing import Effort, Rates, Workload, measure_rates, repeat
from freerein.clients import Channel, SimClient
from freerein.types.common import ActionSpec
from freerein.types.sim import CloseSessionRequest, ConnectRequest, CreateSessionRequest, ResetRequest, StepRequest
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import Frame, TaskDefinition

_TASKS = ("grid", "blocks")
_ENVS = 16
_SEED = 0
_DRAWN_ACTIONS = 256
_LEASE_S = 600.0

Actions: TypeAlias = npt.NDArray[Any]
Step: TypeAlias = Callable[[Actions], Awaitable[object]]


async def measure(effort: Effort) -> Results:
    """Returns the ratios of steps per second, for each world, without and with pixels."""
    results = Results()
    with TemporaryDirectory() as folder:
        async with run_service("sim", data_dir=Path(folder), FREEREIN_SIM_WORKERS="1") as stack:
            for task in (tasks()[name] for name in _TASKS):
                for cameras in ((), (task.spec.cameras[0].name,)):
                    name = f"{task.name}.pixels" if cameras else task.name
                    results += _results(await _measure(task, cameras, stack.addresses["sim"], effort), name)
    return results


async def _measure(task: TaskDefinition, cameras: tuple[str, ...], address: str, effort: Effort) -> Rates:
    async with AsyncExitStack() as opened:
        client = await opened.enter_async_context(SimClient(Channel(address)))

        async def session(num_envs: int) -> _Session:
            return await opened.enter_async_context(_session(client, task.name, num_envs, cameras))

        singles = [await session(1) for _ in range(_ENVS)]
        stream = await opened.enter_async_context(_stream(await session(1)))
        local = opened.enter_context(closing(VectorEnv(task, num_envs=_ENVS, seed=_SEED)))
        local.reset(cameras=cameras)
        peer = opened.enter_context(closing(_sync_vector_env(task, cameras)))

        async def step_local(actions: Actions) -> object:
            return local.step(actions, cameras)

        async def step_peer(actions: Actions) -> object:
            return peer.step(actions)

        async def step_singles(actions: Actions) -> object:
            return await asyncio.gather(*(each.step(row[None]) for each, row in zip(singles, actions, strict=True)))

        ways: tuple[tuple[str, Step, int], ...] = (
            ("syncvector-16", step_peer, _ENVS),
            ("in-process-16", step_local, _ENVS),
            ("unary-16", (await session(_ENVS)).step, _ENVS),
            ("16-unary", step_singles, _ENVS),
            ("unary-1", singles[0].step, 1),
            ("connect-1", stream, 1),
        )
        return await measure_rates([_workload(*way, task.spec.action) for way in ways], effort)


def _results(times: Rates, name: str) -> Results:
    return Results(
        ratios=(
            Ratio(f"sim.connect_vs_unary.{name}", times.speedup("connect-1", over="unary-1")),
            Ratio(f"sim.step16_vs_16_unary.{name}", times.speedup("unary-16", over="16-unary")),
            Ratio(f"sim.network_vs_syncvector.{name}", times.speedup("unary-16", over="syncvector-16")),
            Ratio(f"sim.in_process_vs_syncvector.{name}", times.speedup("in-process-16", over="syncvector-16")),
        ),
        rates={f"sim.{name}": times},
    )


def _workload(name: str, step: Step, num_envs: int, spec: ActionSpec) -> Workload:
    actions = _actions(spec, num_envs)
    return Workload(name, repeat(lambda: step(next(actions))), num_envs, "steps")


def _actions(spec: ActionSpec, num_envs: int) -> Iterator[Actions]:
    """Returns an endless iterator of random actions, (num_envs, size), drawn in advance."""
    rng, shape = np.random.default_rng(_SEED), (_DRAWN_ACTIONS, num_envs, spec.size)
    drawn = rng.integers(spec.choices, size=shape) if spec.choices else rng.uniform(-1, 1, shape).astype(np.float32)
    return cycle(drawn)


def _sync_vector_env(task: TaskDefinition, cameras: tuple[str, ...]) -> SyncVectorEnv[Any, Any]:
    seeds = np.random.SeedSequence(_SEED).spawn(_ENVS)
    envs = SyncVectorEnv(
        [partial(_WorldEnv, task, cameras, seed=seed) for seed in seeds],
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    envs.reset()
    return envs


@dataclass(frozen=True)
class _Session:
    """A session of the sim service, stepped by unary calls."""

    client: SimClient
    id: str
    cameras: tuple[str, ...]
    step_ids: Iterator[int] = field(default_factory=lambda: count(1))

    def request(self, actions: Actions) -> StepRequest:
        return StepRequest(self.id, next(self.step_ids), actions, self.cameras)

    async def step(self, actions: Actions) -> object:
        return await self.client.step(self.request(actions))


@asynccontextmanager
async def _session(client: SimClient, task: str, num_envs: int, cameras: tuple[str, ...]) -> AsyncIterator[_Session]:
    created = await client.create_session(CreateSessionRequest(task, num_envs, seed=_SEED, lease_s=_LEASE_S))
    await client.reset(ResetRequest(created.session))
    yield _Session(client, created.session, cameras)
    await client.close_session(CloseSessionRequest(created.session))


@asynccontextmanager
async def _stream(session: _Session) -> AsyncIterator[Step]:
    """Opens a `Connect` stream; yields a function that steps the session on it."""
    async with exchange(session.client.connect) as ask:

        async def step(actions: Actions) -> object:
            reply = await ask(ConnectRequest(step=session.request(actions)))
            if reply.step is None:
                raise RuntimeError(f"A step must be answered by a step; got {reply}.")
            return reply.step

        yield step


class _WorldEnv(gymnasium.Env[Frame, npt.NDArray[Any]]):
    """One world as a Gymnasium environment, without the sim service; an observation is uint8 (H, W, C), or (0,)."""

    def __init__(self, task: TaskDefinition, cameras: tuple[str, ...], *, seed: np.random.SeedSequence) -> None:
        self._world = task.make()
        self._max_steps = task.spec.max_episode_steps
        self._camera = next((camera for camera in task.spec.cameras if camera.name in cameras), None)
        self._rng = np.random.default_rng(seed)
        self._steps = 0
        shape = (0,) if self._camera is None else (self._camera.height, self._camera.width, self._camera.channels)
        self.observation_space = spaces.Box(0, 255, shape, np.uint8)
        self.action_space = _action_space(task.spec.action)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Frame, dict[str, Any]]:
        """Starts an episode with the next numbers of the generator."""
        self._world.reset(self._rng)
        self._steps = 0
        return self._observe(), {}

    def step(self, action: npt.NDArray[Any]) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        """Takes one action."""
        outcome = self._world.step(action)
        self._steps += 1
        return self._observe(), 0.0, outcome.terminated, self._steps >= self._max_steps, {}

    def close(self) -> None:
        """Closes the world."""
        self._world.close()

    def _observe(self) -> Frame:
        if self._camera is None:
            return np.empty(0, np.uint8)
        return self._world.render(self._camera.name, height=self._camera.height, width=self._camera.width)


def _action_space(action: ActionSpec) -> spaces.Space[npt.NDArray[Any]]:
    if action.choices:
        return spaces.MultiDiscrete([action.choices] * action.size)
    return spaces.Box(-1.0, 1.0, (action.size,), np.float32)
