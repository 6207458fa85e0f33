"""Steps per second of the sim service, over its socket and in process, beside Gymnasium's `SyncVectorEnv`.

All of them step the same worlds with actions drawn alike. The service has one worker process, so that it gains nothing
by a second core that the others could not have. What crosses the socket is stepped in turn: no call is sent before the
last was answered, but for the sixteen that belong together.
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

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from benchmarks.report import Findings, Ratio
from benchmarks.rounds import Contestant, Effort, Times, race
from benchmarks.services import running
from benchmarks.world_env import WorldEnv
from freerein.clients import Channel, SimClient
from freerein.types.common import ActionSpec
from freerein.types.sim import CloseSessionRequest, ConnectRequest, CreateSessionRequest, ResetRequest, StepRequest
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition

_TASKS = ("grid", "blocks")
_ENVS = 16
_SEED = 0
_DRAWN = 256
_LEASE_S = 600.0

Actions: TypeAlias = npt.NDArray[Any]
Step: TypeAlias = Callable[[Actions], Awaitable[object]]


async def measure(effort: Effort) -> Findings:
    """Returns how the ways to step compare, for each world, without and with pixels."""
    found = Findings()
    with TemporaryDirectory() as folder:
        async with running("sim", data_dir=Path(folder), FREEREIN_SIM_WORKERS="1") as stack:
            for task in (tasks()[name] for name in _TASKS):
                for cameras in ((), (task.spec.cameras[0].name,)):
                    name = f"{task.name}.pixels" if cameras else task.name
                    found += _findings(await _race(task, cameras, stack.addresses["sim"], effort), name)
    return found


async def _race(task: TaskDefinition, cameras: tuple[str, ...], address: str, effort: Effort) -> Times:
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
            ("connect-1", stream.step, 1),
        )
        return await race([_contestant(*way, task.spec.action) for way in ways], effort)


def _findings(times: Times, name: str) -> Findings:
    return Findings(
        ratios=(
            Ratio(f"sim.connect_vs_unary.{name}", times.speedup("connect-1", over="unary-1")),
            Ratio(f"sim.step16_vs_16_unary.{name}", times.speedup("unary-16", over="16-unary")),
            Ratio(f"sim.network_vs_syncvector.{name}", times.speedup("unary-16", over="syncvector-16")),
            Ratio(f"sim.in_process_vs_syncvector.{name}", times.speedup("in-process-16", over="syncvector-16")),
        ),
        raw={f"sim.{name}": times},
    )


def _contestant(name: str, step: Step, num_envs: int, spec: ActionSpec) -> Contestant:
    actions = _actions(spec, num_envs)

    async def run(times: int) -> None:
        for _ in range(times):
            await step(next(actions))

    return Contestant(name, run, num_envs, "steps")


def _actions(spec: ActionSpec, num_envs: int) -> Iterator[Actions]:
    """Returns random actions without end, (num_envs, size) each; drawn beforehand, as drawing takes time."""
    rng, shape = np.random.default_rng(_SEED), (_DRAWN, num_envs, spec.size)
    drawn = rng.integers(spec.choices, size=shape) if spec.choices else rng.uniform(-1, 1, shape).astype(np.float32)
    return cycle(drawn)


def _sync_vector_env(task: TaskDefinition, cameras: tuple[str, ...]) -> SyncVectorEnv[Any, Any]:
    seeds = np.random.SeedSequence(_SEED).spawn(_ENVS)
    envs = SyncVectorEnv(
        [partial(WorldEnv, task, cameras, seed=seed) for seed in seeds],
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    envs.reset()
    return envs


@dataclass(frozen=True)
class _Session:
    """A session of the service, stepped by unary calls."""

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


class _Stream:
    """A session stepped on a stream, one message after the other."""

    def __init__(self, session: _Session) -> None:
        self._session = session
        self._requests: asyncio.Queue[ConnectRequest] = asyncio.Queue()
        self._replies = session.client.connect(self._sent())

    async def step(self, actions: Actions) -> object:
        await self._requests.put(ConnectRequest(step=self._session.request(actions)))
        reply = await anext(self._replies)
        if reply.step is None:
            raise RuntimeError(f"A step must be answered by a step; got {reply}.")
        return reply.step

    async def close(self) -> None:
        await self._replies.aclose()

    async def _sent(self) -> AsyncIterator[ConnectRequest]:
        while True:
            yield await self._requests.get()


@asynccontextmanager
async def _stream(session: _Session) -> AsyncIterator[_Stream]:
    stream = _Stream(session)
    yield stream
    await stream.close()
