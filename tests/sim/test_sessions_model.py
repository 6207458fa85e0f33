"""Whatever is asked in whatever order, sessions answer as environments in process do."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, rule, run_state_machine_as_test

from freerein.errors import Overloaded, ServiceError, SessionNotFound, StepOutOfOrder
from freerein.fork_server import StartChild
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ResetRequest,
    ResetResponse,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
    StepResponse,
)
from freerein_sim.core import SimCore
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import grid

GRID = next(task for task in grid.TASKS if task.name == "grid")
MAX_SESSIONS = 3
LEASE_S = 60.0
TOP = ("top",)

Outcome = tuple[object, ...] | type[ServiceError]


class Service:
    """The service under test, driven from outside its event loop, and its clock."""

    def __init__(self, runner: asyncio.Runner, fork_worker: StartChild) -> None:
        self.now_s = 0.0
        self.run = runner.run
        self.sessions = SimCore(WorkerPool(fork_worker, workers=2), max_sessions=MAX_SESSIONS, clock=lambda: self.now_s)


@dataclass(eq=False)
class Held:
    """A session, and the environments that it must be like."""

    session: str
    envs: VectorEnv
    last: tuple[StepRequest, Outcome] | None = None
    is_open: bool = True


def bits(answer: object) -> tuple[object, ...]:
    """Returns an answer as values that are equal when all of its bits are."""
    if isinstance(answer, ResetResponse | StepResponse):
        return tuple(part for name in sorted(vars(answer)) for part in (name, *bits(getattr(answer, name))))
    if isinstance(answer, dict):
        return tuple(part for key in sorted(answer) for part in (key, *bits(answer[key])))
    if isinstance(answer, np.ndarray):
        return (answer.dtype, answer.shape, answer.tobytes())
    return (answer,)


def outcome(call: Callable[[], object]) -> Outcome:
    """Returns what a call answers, or the class of its error."""
    try:
        return bits(call())
    except ServiceError as error:
        return type(error)


class Clients(RuleBasedStateMachine):
    """Clients who do what they may, and what they may not."""

    held = Bundle("held")
    kept = Bundle("kept")

    def __init__(self, service: Service) -> None:
        super().__init__()
        self.service = service
        self.sessions = service.sessions
        self.open: list[Held] = []

    def check(self, held: Held, call: Coroutine[object, object, object], like: Callable[[], object]) -> Outcome:
        """Returns the outcome of a call, which is that of doing the like in process."""
        answer = outcome(lambda: self.service.run(call))
        assert answer == (outcome(like) if held.is_open else SessionNotFound)
        return answer

    @rule(target=held, num_envs=st.integers(1, 2), seed=st.integers(0, 3))
    def create(self, num_envs: int, seed: int) -> Held:
        request = CreateSessionRequest("grid", num_envs=num_envs, seed=seed, lease_s=LEASE_S)
        if len(self.open) == MAX_SESSIONS:
            with pytest.raises(Overloaded):
                self.service.run(self.sessions.create_session(request))
            return self.open[0]
        created = self.service.run(self.sessions.create_session(request))
        self.open.append(Held(created.session, VectorEnv(GRID, num_envs=num_envs, seed=seed)))
        return self.open[-1]

    @rule(held=held, envs=st.sampled_from([(), (), (0,), (1,)]), seed=st.none() | st.integers(0, 3))
    def reset(self, held: Held, envs: tuple[int, ...], seed: int | None) -> None:
        request = ResetRequest(held.session, envs, seed, TOP)
        self.check(held, self.sessions.reset(request), lambda: held.envs.reset(envs, seed, cameras=TOP))

    @rule(held=held, choices=st.lists(st.integers(0, 5), min_size=2, max_size=2))
    def step(self, held: Held, choices: list[int]) -> None:
        actions = np.array(choices[: held.envs.num_envs]).reshape(-1, 1)
        request = StepRequest(held.session, held.envs.step_id + 1, actions, TOP)
        answer = self.check(held, self.sessions.step(request), lambda: held.envs.step(actions, TOP))
        if isinstance(answer, tuple):
            held.last = request, answer

    @rule(held=held)
    def step_once_more(self, held: Held) -> None:
        if held.last is not None:
            request, answer = held.last
            again = outcome(lambda: self.service.run(self.sessions.step(request)))
            assert again == (answer if held.is_open else SessionNotFound)

    @rule(held=held, ahead=st.integers(2, 9))
    def step_out_of_turn(self, held: Held, ahead: int) -> None:
        request = StepRequest(held.session, held.envs.step_id + ahead, np.zeros((held.envs.num_envs, 1), np.int64))
        answer = outcome(lambda: self.service.run(self.sessions.step(request)))
        assert answer is (StepOutOfOrder if held.is_open else SessionNotFound)

    @rule(target=kept, held=held)
    def keep(self, held: Held) -> bytes:
        async def keep() -> object:
            return (await self.sessions.snapshot(SnapshotRequest(held.session))).snapshot

        answer = self.check(held, keep(), held.envs.snapshot)
        return answer[0] if isinstance(answer, tuple) else b"none"

    @rule(held=held, snapshot=kept)
    def restore(self, held: Held, snapshot: bytes) -> None:
        async def restore() -> object:
            return (await self.sessions.restore(RestoreRequest(held.session, snapshot))).step_id

        def like() -> object:
            held.envs.restore(snapshot)
            return held.envs.step_id

        if isinstance(self.check(held, restore(), like), tuple):
            held.last = None

    @rule(
        held=held,
        snapshot=kept,
        chosen=st.sampled_from([((0,), (0,)), ((1,), (0,)), ((0, 1), (1, 1)), ((1, 0), (0, 1)), ((0, 1), (0,))]),
    )
    def restore_single_envs(self, held: Held, snapshot: bytes, chosen: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
        async def restore() -> object:
            return (await self.sessions.restore(RestoreRequest(held.session, snapshot, *chosen))).step_id

        def like() -> object:
            held.envs.restore(snapshot, *chosen)
            return held.envs.step_id

        if isinstance(self.check(held, restore(), like), tuple):
            held.last = None

    @rule(held=held)
    def close(self, held: Held) -> None:
        self.service.run(self.sessions.close_session(CloseSessionRequest(held.session)))
        self.end(held)

    @rule()
    def stay_away_for_a_lease(self) -> None:
        self.service.now_s += LEASE_S
        for held in list(self.open):
            self.end(held)
        self.service.run(self.reap())

    def end(self, held: Held) -> None:
        held.is_open = False
        self.open = [each for each in self.open if each is not held]

    async def reap(self) -> None:
        self.sessions.reap()
        assert len(self.sessions) == 0

    def teardown(self) -> None:
        self.stay_away_for_a_lease()


@pytest.mark.fault("M7")
@pytest.mark.fault("M13")
def test_sessions_answer_as_environments_in_process_whatever_is_asked(fork_worker: StartChild) -> None:
    with asyncio.Runner() as runner:
        service = Service(runner, fork_worker)
        runner.run(service.sessions.start())
        try:
            run_state_machine_as_test(
                lambda: Clients(service),
                settings=settings(max_examples=10, stateful_step_count=30, database=None),
            )
        finally:
            runner.run(service.sessions.close())
