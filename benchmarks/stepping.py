"""Steps per second of the sim service, over its socket and in process, beside Gymnasium's `SyncVectorEnv`.

All of them step the same worlds with the same actions. The service has one worker process, so that nobody gains by a
second core what the others could not.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AsyncExitStack, aclosing, closing
from dataclasses import dataclass, field
from itertools import count as count_from
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from benchmarks.report import Findings, Ratio
from benchmarks.rounds import Contestant, Effort, Times, race
from benchmarks.services import running
from benchmarks.world_env import WorldEnv
from freerein.clients import Channel, SimClient
from freerein.types.sim import ActionSpec, ConnectRequest, CreateSessionRequest, ResetRequest, StepRequest
from freerein_sim.workers.envs import Envs
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import Task

_TASKS = ("grid", "blocks")
_ENVS = 16
_SEED = 0
_LEASE_S = 600.0

Step = Callable[[npt.NDArray[Any]], Awaitable[object]]


async def measure(effort: Effort) -> Findings:
    """Returns how the ways to step compare, for each world, without and with pixels."""
    found = Findings()
    with TemporaryDirectory() as folder:
        async with running("sim", data_dir=Path(folder), FREEREIN_SIM_WORKERS="1") as stack:
            for name in _TASKS:
                task = tasks()[name]
                for cameras in ((), (task.spec.cameras[0].name,)):
                    found += await _measure_task(task, cameras, stack.addresses["sim"], effort)
    return found


async def _measure_task(task: Task, cameras: tuple[str, ...], address: str, effort: Effort) -> Findings:
    async with AsyncExitStack() as opened:
        client = await opened.enter_async_context(SimClient(Channel(address)))
        singles = [await _Session.create(client, task.name, cameras, num_envs=1) for _ in range(_ENVS)]
        streamed = await _Session.create(client, task.name, cameras, num_envs=1)
        vector = await _Session.create(client, task.name, cameras, num_envs=_ENVS)
        envs = opened.enter_context(closing(Envs(task, num_envs=_ENVS, seed=_SEED)))
        envs.reset(cameras=cameras)
        peer = opened.enter_context(closing(_sync_vector_env(task, cameras)))

        async def step_in_process(actions: npt.NDArray[Any]) -> object:
            return envs.step(actions, cameras)

        async def step_peer(actions: npt.NDArray[Any]) -> object:
            return peer.step(actions)

        async def step_singles(actions: npt.NDArray[Any]) -> object:
            return await asyncio.gather(
                *(session.step(action[None]) for session, action in zip(singles, actions, strict=True))
            )

        draw = _Draw(task.spec.action)
        times = await race(
            [
                _contestant("syncvector-16", step_peer, draw, _ENVS),
                _contestant("in-process-16", step_in_process, draw, _ENVS),
                _contestant("unary-16", vector.step, draw, _ENVS),
                _contestant("16-unary", step_singles, draw, _ENVS),
                _contestant("unary-1", singles[0].step, draw, 1),
                Contestant("connect-1", lambda count: streamed.connect(draw.many(count)), 1, "steps"),
            ],
            effort,
        )
        for session in (*singles, streamed, vector):
            await session.close()
    return _findings(times, f"{task.name}.pixels" if cameras else task.name)
