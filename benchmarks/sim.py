"""Steps per second of the sim service over the network, beside the same worlds in process.

All step with random actions. The service has one worker process, so that it has no more cores than the others. Each
network call is sent after the reply to the last.
"""

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import dataclass, field
from itertools import count, cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from benchmarks.report import Ratio, Results
from benchmarks.servers import exchange, run_service
from benchmarks.timing import Effort, Rates, Workload, measure_rates, repeat
from freerein.clients import Channel, SimClient
from freerein.types.common import ActionSpec
from freerein.types.sim import CloseSessionRequest, ConnectRequest, CreateSessionRequest, ResetRequest, StepRequest
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition

_TASKS = ("grid", "blocks", "doom", "office", "rope")
_ENVS = 16
_SEED = 0
_DRAWN_ACTIONS = 256
_LEASE_S = 600.0

Actions: TypeAlias = npt.NDArray[Any]
Step: TypeAlias = Callable[[Actions], Awaitable[object]]


async def measure(effort: Effort) -> Results:
    """Returns the ratios of steps per second, with frames, for each world."""
    results = Results()
    with TemporaryDirectory() as folder:
        async with run_service("sim", data_dir=Path(folder), FREEREIN_SIM_WORKERS="1") as stack:
            for task in (tasks()[name] for name in _TASKS):
                rates = await _measure(task, (task.spec.cameras[0].name,), stack.addresses["sim"], effort)
                results += _results(rates, task.name)
    return results


async def _measure(task: TaskDefinition, cameras: tuple[str, ...], address: str, effort: Effort) -> Rates:
    async with AsyncExitStack() as opened:
        client = await opened.enter_async_context(SimClient(Channel(address)))

        async def session(num_envs: int) -> _Session:
            return await opened.enter_async_context(_session(client, task.name, num_envs, cameras))

        stream = await opened.enter_async_context(_stream(await session(1)))
        local = opened.enter_context(closing(VectorEnv(task, num_envs=_ENVS, seed=_SEED)))
        local.reset(cameras=cameras)

        async def step_local(actions: Actions) -> object:
            return local.step(actions, cameras)

        ways: tuple[tuple[str, Step, int], ...] = (
            ("in-process-16", step_local, _ENVS),
            ("unary-16", (await session(_ENVS)).step, _ENVS),
            ("unary-1", (await session(1)).step, 1),
            ("connect-1", stream, 1),
        )
        return await measure_rates([_workload(*way, task.spec.action) for way in ways], effort)


def _results(times: Rates, name: str) -> Results:
    return Results(
        ratios=(
            Ratio(f"sim.connect_vs_unary.{name}", times.speedup("connect-1", over="unary-1")),
            Ratio(f"sim.network_vs_in_process.{name}", times.speedup("unary-16", over="in-process-16")),
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
