"""The rules of sessions, over real worker processes."""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    Bundle,
    RuleBasedStateMachine,
    consumes,
    initialize,
    invariant,
    multiple,
    precondition,
    rule,
    run_state_machine_as_test,
)

from freerein.errors import (
    AlreadyExists,
    FailedPrecondition,
    InvalidInput,
    NotFound,
    Overloaded,
    ServiceError,
    Unavailable,
    WorkerLost,
)
from freerein.types.sim import (
    CloseSessionRequest,
    CloseSessionResponse,
    CreateSessionRequest,
    DemonstrateRequest,
    ListTasksRequest,
    RenderRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
    StepResponse,
)
from freerein_sim.sessions import Sessions
from freerein_sim.workers.envs import Envs
from freerein_sim.workers.pool import Pool
from freerein_sim.worlds import grid

GRID = next(task for task in grid.TASKS if task.name == "grid")
ONE = CreateSessionRequest("grid", seed=1)
UP = np.zeros((1, 1), np.int64)


@dataclass
class Clock:
    """A clock that is set by hand."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s


StartSessions = Callable[..., Awaitable[Sessions]]


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
async def start(clock: Clock) -> AsyncIterator[StartSessions]:
    """A function that starts sessions, closed with the test."""
    started: list[Sessions] = []

    async def start_sessions(*, workers: int = 1, max_sessions: int = 64) -> Sessions:
        started.append(Sessions(Pool(workers=workers), max_sessions=max_sessions, clock=clock))
        await started[-1].start()
        return started[-1]

    yield start_sessions
    for sessions in started:
        await sessions.close()


async def begun(sessions: Sessions, request: CreateSessionRequest = ONE) -> str:
    session = (await sessions.create_session(request)).session
    await sessions.reset(ResetRequest(session))
    return session
