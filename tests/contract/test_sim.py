"""The sim service over every transport: what reads the true state has the same answer, or the same error."""

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pytest_asyncio

from freerein import wire
from freerein.errors import ServiceError
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.wording import with_paths
from freerein.types.sim import (
    CheckRequest,
    CreateSessionRequest,
    DrawRecipesRequest,
    ExpertActionsRequest,
    Recipe,
    ResetRequest,
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
    ("ExpertActions", "0" * 32, {}, "session_not_found"),
    ("Reset", PRIVILEGED, {"seed": 3, "recipes": (Recipe(("pick-red",)), Recipe())}, ANSWER),
    ("Reset", PRIVILEGED, {"recipes": (Recipe(("pick-red",)), Recipe(("pick-red", "pick-red")))}, "invalid_input"),
    ("Step", PRIVILEGED, {"step_id": 5, "actions": ACTIONS}, "step_out_of_order"),
]
REQUESTS = {
    "Check": CheckRequest,
    "ExpertActions": ExpertActionsRequest,
    "Reset": ResetRequest,
    "Step": StepRequest,
}


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


async def outcome(transport: Any, method: Any, request: object) -> object:
    """Returns what a request came to."""
    try:
        return [wire.to_json(response) for response in await transport(method, request)]
    except ServiceError as error:
        return error.code, error.field, with_paths(error.detail), with_paths(error.hint)


@pytest.mark.parametrize(("method", "session", "fields", "code"), CASES)
async def test_a_request_has_the_same_outcome_over_every_transport(
    transports: Any, method: str, session: str, fields: dict[str, Any], code: str
) -> None:
    request = REQUESTS[method](await create(transports, session), **fields)

    outcomes = [await outcome(transport, transports.method(method), request) for transport in transports.all]

    assert outcomes[0] == outcomes[1] == outcomes[2]
    assert isinstance(outcomes[0], list) == (code == ANSWER)
    assert code == ANSWER or (outcomes[0][0] == code and outcomes[0][3])


async def test_the_experts_of_equal_sessions_act_alike_over_every_transport(transports: Any) -> None:
    method, recipes = transports.method("ExpertActions"), (Recipe(("pick-red",)), Recipe())

    outcomes = [
        await outcome(transport, method, ExpertActionsRequest(await create(transports), recipes))
        for transport in transports.all
    ]

    assert outcomes[0] == outcomes[1] == outcomes[2]
    assert isinstance(outcomes[0], list)


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"task": "grid", "count": 3, "seed": 1}, ANSWER),
        ({"task": "grid", "count": 0}, "invalid_input"),
        ({"task": "grid", "max_skills": 6}, "invalid_input"),
        ({"task": "grid", "skills": ("no-such",)}, "invalid_input"),
        ({"task": "grid", "conditions": ("no-such",)}, "invalid_input"),
        ({"task": "pendulum"}, "unimplemented"),
        ({"task": "no-such"}, "not_found"),
    ],
)
async def test_recipes_are_drawn_alike_over_every_transport(transports: Any, fields: dict[str, Any], code: str) -> None:
    method, request = transports.method("DrawRecipes"), DrawRecipesRequest(**fields)

    outcomes = [await outcome(transport, method, request) for transport in transports.all]

    assert outcomes[0] == outcomes[1] == outcomes[2]
    assert isinstance(outcomes[0], list) == (code == ANSWER)
    assert code == ANSWER or outcomes[0][0] == code


async def test_tasks_are_listed_and_snapshots_taken_over_every_transport(transports: Any) -> None:
    for method, request in (
        ("ListTasks", transports.method("ListTasks").request()),
        ("Snapshot", SnapshotRequest(await create(transports))),
    ):
        outcomes = [await outcome(transport, transports.method(method), request) for transport in transports.all]
        assert outcomes[0] == outcomes[1] == outcomes[2]
        assert isinstance(outcomes[0], list)
