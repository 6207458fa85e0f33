"""The sim service over every transport: what reads the true state has the same answer, or the same error."""

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pytest_asyncio

from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.sim import (
    Behaviour,
    CreateSessionRequest,
    ExpertActionsRequest,
    Recipe,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")

STATES = np.zeros((2, 3, 12))
ACTIONS = np.zeros((2, 1), np.int64)
ANSWER, PRIVILEGED, UNPRIVILEGED = "", "privileged", "unprivileged"
CASES = [
    ("Check", PRIVILEGED, {"predicate": "completed/pick-red", "states": STATES}, ANSWER),
    ("Check", PRIVILEGED, {"predicate": "at-landmark", "states": STATES, "references": STATES}, ANSWER),
    ("Check", PRIVILEGED, {"predicate": "at-landmark", "states": STATES}, "invalid_input"),
    ("Check", PRIVILEGED, {"predicate": "completed/pick-red", "states": STATES[0]}, "invalid_input"),
    ("Check", PRIVILEGED, {"predicate": "completed/pick-red", "states": STATES * np.nan}, "invalid_input"),
    ("Check", PRIVILEGED, {"predicate": "no-such", "states": STATES}, "invalid_input"),
    ("Check", UNPRIVILEGED, {"predicate": "completed/pick-red", "states": STATES}, "failed_precondition"),
    ("Check", "0" * 32, {"predicate": "completed/pick-red", "states": STATES}, "session_not_found"),
    ("ExpertActions", PRIVILEGED, {"recipes": (Recipe(("pick-red",)),)}, "invalid_input"),
    ("ExpertActions", PRIVILEGED, {"recipes": (Recipe(("no-such",)),) * 2}, "invalid_input"),
    ("ExpertActions", PRIVILEGED, {"recipes": (Recipe(("pick-red",) * 257),) * 2}, "invalid_input"),
    ("ExpertActions", UNPRIVILEGED, {}, "failed_precondition"),
    ("ExpertActions", UNPRIVILEGED, {"behaviour": "random"}, "failed_precondition"),
    ("ExpertActions", "0" * 32, {}, "session_not_found"),
    ("Reset", PRIVILEGED, {"seed": 3, "recipes": (Recipe(("pick-red",)), Recipe())}, ANSWER),
    ("Reset", PRIVILEGED, {"recipes": (Recipe(("pick-red",)), Recipe(("pick-red", "pick-red")))}, "invalid_input"),
    ("Step", PRIVILEGED, {"step_id": 5, "actions": ACTIONS}, "step_out_of_order"),
    ("DrawRecipes", None, {"task": "grid", "count": 3, "seed": 1}, ANSWER),
    ("DrawRecipes", None, {"task": "grid", "count": 0}, "invalid_input"),
    ("DrawRecipes", None, {"task": "grid", "max_skills": 6}, "invalid_input"),
    ("DrawRecipes", None, {"task": "grid", "skills": ("no-such",)}, "invalid_input"),
    ("DrawRecipes", None, {"task": "grid", "conditions": ("no-such",)}, "invalid_input"),
    ("DrawRecipes", None, {"task": "pendulum"}, "unimplemented"),
    ("DrawRecipes", None, {"task": "no-such"}, "not_found"),
    ("ListTasks", None, {}, ANSWER),
    ("Snapshot", PRIVILEGED, {}, ANSWER),
]


def build(_data_dir: Path, health: Health) -> Service:
    from freerein_sim.__main__ import build
    from freerein_sim.settings import SimSettings

    return build(SimSettings(sim_workers=1), Limits(), Metrics(), health)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def transports(
    connect: Callable[..., AbstractAsyncContextManager[Any]], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Any]:
    async with connect(build, tmp_path_factory.mktemp("sim")) as opened:
        yield opened


async def create(transports: Any, name: str = PRIVILEGED) -> str:
    """Returns the session of that name, with its first episodes begun; an unknown name is that of no session."""
    if name not in (PRIVILEGED, UNPRIVILEGED):
        return name
    request = CreateSessionRequest("grid", num_envs=2, seed=1, privileged=name == PRIVILEGED)
    (created,) = await transports.core(transports.method("CreateSession"), request)
    await transports.core(transports.method("Reset"), ResetRequest(created.session))
    return str(created.session)


@pytest.mark.parametrize(("method", "session", "fields", "code"), CASES)
async def test_a_request_has_the_same_outcome_over_every_transport(
    transports: Any, method: str, session: str | None, fields: dict[str, Any], code: str
) -> None:
    named = {} if session is None else {"session": await create(transports, session)}
    outcome = await transports.outcome(method, transports.method(method).request(**named, **fields))
    assert isinstance(outcome, list) == (code == ANSWER)
    assert code == ANSWER or (outcome[0] == code and (outcome[3] or method == "DrawRecipes"))


@pytest.mark.parametrize(
    ("envs", "sources", "code"),
    [
        ((1,), (0,), ANSWER),
        ((0, 1), (1, 1), ANSWER),
        ((2,), (0,), "invalid_input"),
        ((0, 0), (0, 1), "invalid_input"),
        ((0,), (2,), "invalid_input"),
        ((0,), (), "invalid_input"),
        ((), (0, 1), "invalid_input"),
        (tuple(range(65)), (0,), "invalid_input"),
    ],
)
async def test_single_envs_are_restored_alike_over_every_transport(
    transports: Any, envs: tuple[int, ...], sources: tuple[int, ...], code: str
) -> None:
    session = await create(transports)
    (saved,) = await transports.core(transports.method("Snapshot"), SnapshotRequest(session))
    await transports.core(transports.method("Step"), StepRequest(session, 1, ACTIONS))
    outcome = await transports.outcome("Restore", RestoreRequest(session, saved.snapshot, envs, sources))
    assert (outcome if code == ANSWER else outcome[0]) == (code or [{"step_id": 1}])


@pytest.mark.parametrize("behaviour", ["expert", "random"])
async def test_the_scripted_policies_of_equal_sessions_act_alike_over_every_transport(
    transports: Any, behaviour: Behaviour
) -> None:
    recipes = (Recipe(("pick-red",)), Recipe())
    requests = [ExpertActionsRequest(await create(transports), recipes, behaviour) for _ in transports.all]
    assert isinstance(await transports.outcome("ExpertActions", *requests), list)
