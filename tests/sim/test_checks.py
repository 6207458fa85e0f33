"""The RPCs `Check` and `ExpertActions`, over a real worker process."""

from collections.abc import AsyncIterator
from contextlib import closing

import numpy as np
import numpy.typing as npt
import pytest
import pytest_asyncio

from freerein.errors import FailedPrecondition, InvalidInput, Unimplemented
from freerein.fork_server import StartChild
from freerein.types.sim import (
    CheckRequest,
    CreateSessionRequest,
    DemonstrateRequest,
    ExpertActionsRequest,
    Recipe,
    ResetRequest,
    StepRequest,
)
from freerein_sim.core import SimCore
from freerein_sim.workers.checks import check
from freerein_sim.workers.pool import WorkerPool
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import grid

pytestmark = pytest.mark.asyncio(loop_scope="module")

GRID = next(task for task in grid.TASKS if task.name == "grid")
STATES = np.zeros((2, 3, 12))


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def core(fork_worker: StartChild) -> AsyncIterator[SimCore]:
    shared = SimCore(WorkerPool(fork_worker, workers=1))
    await shared.start()
    yield shared
    await shared.close()


async def create(core: SimCore, task: str = "grid", *, num_envs: int = 2, privileged: bool = True) -> str:
    request = CreateSessionRequest(task, num_envs=num_envs, seed=3, privileged=privileged)
    return (await core.create_session(request)).session


def run_expert(envs: VectorEnv, *recipes: Recipe, steps: int) -> npt.NDArray[np.bool_]:
    """Lets the experts act for a number of steps; returns which have finished then."""
    for _ in range(steps):
        envs.step(envs.expert_actions(recipes).actions)
    return envs.expert_actions(recipes).finished


async def test_a_predicate_is_checked_before_any_reset(core: SimCore) -> None:
    session = await create(core)
    states = STATES.copy()
    states[1, 2, 2:4] = -1  # red is gone

    response = await core.check(CheckRequest(session, "completed/pick-red", states))

    assert response.holds.dtype == np.bool_
    assert response.holds.tolist() == [[False] * 3, [False, False, True]]


async def test_states_are_compared_with_references(core: SimCore) -> None:
    session = await create(core)
    references = STATES.copy()
    references[0, 1] = 1

    response = await core.check(CheckRequest(session, "at-landmark", STATES, references))

    assert response.holds.tolist() == [[True, False, True], [True] * 3]


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"predicate": "no-such"}, "predicate"),
        ({"predicate": ""}, "predicate"),
        ({"states": STATES[0]}, "states"),
        ({"states": STATES[..., :-1]}, "states"),
        ({"states": STATES.astype(np.float32)}, "states"),
        ({"states": STATES[:0]}, "states"),
        ({"states": np.full_like(STATES, np.nan)}, "states"),
        ({"references": None}, "references"),
        ({"references": STATES[:1]}, "references"),
        ({"references": STATES.astype(np.float32)}, "references"),
        ({"references": np.full_like(STATES, np.inf)}, "references"),
        ({"predicate": "completed/pick-red"}, "references"),
    ],
)
async def test_a_check_that_does_not_fit_is_refused(core: SimCore, fields: dict[str, object], field: str) -> None:
    session = await create(core)
    request = {"predicate": "at-landmark", "states": STATES, "references": STATES, **fields}

    with pytest.raises(InvalidInput) as caught:
        await core.check(CheckRequest(session, **request))

    assert caught.value.field == field
    assert caught.value.hint


async def test_a_check_has_at_most_a_million_rows() -> None:
    states = np.broadcast_to(0.0, (1_000_001, 1, 12))

    with pytest.raises(InvalidInput, match="1 to 1000000 rows"):
        check(GRID, CheckRequest("", "completed/pick-red", states))


async def test_an_unknown_predicate_is_answered_by_those_there_are(core: SimCore) -> None:
    with pytest.raises(InvalidInput) as caught:
        await core.check(CheckRequest(await create(core), "no-such", STATES))

    assert "at-landmark, object-moves, completed/pick-red" in caught.value.hint


async def test_truth_is_for_privileged_sessions(core: SimCore) -> None:
    session = await create(core, privileged=False)
    await core.reset(ResetRequest(session))

    with pytest.raises(FailedPrecondition, match="Check reads the true state"):
        await core.check(CheckRequest(session, "at-landmark", STATES, STATES))
    with pytest.raises(FailedPrecondition, match="ExpertActions reads the true state"):
        await core.expert_actions(ExpertActionsRequest(session))


async def test_the_expert_acts_over_the_service_as_in_process(core: SimCore) -> None:
    session = await create(core)
    await core.reset(ResetRequest(session))
    recipes = (Recipe(("pick-red",)), Recipe(("pick-blue", "pick-green")))

    with closing(VectorEnv(GRID, num_envs=2, seed=3)) as envs:
        envs.reset()
        for step_id in range(1, 8):
            expected = envs.expert_actions(recipes)
            response = await core.expert_actions(ExpertActionsRequest(session, recipes))
            np.testing.assert_array_equal(response.actions, expected.actions)
            np.testing.assert_array_equal(response.finished, expected.finished)
            envs.step(expected.actions)
            await core.step(StepRequest(session, step_id, response.actions))


async def test_the_expert_needs_an_episode_and_recipes_that_fit(core: SimCore) -> None:
    session = await create(core)
    with pytest.raises(FailedPrecondition, match="ExpertActions needs episodes"):
        await core.expert_actions(ExpertActionsRequest(session))
    await core.reset(ResetRequest(session))

    for recipes in ((Recipe(()),), (Recipe(()), Recipe(("no-such-skill",)))):
        with pytest.raises(InvalidInput) as caught:
            await core.expert_actions(ExpertActionsRequest(session, recipes))
        assert caught.value.field == "recipes"


async def test_a_task_without_an_expert_says_so(core: SimCore) -> None:
    session = await create(core, "blocks.scatter")
    await core.reset(ResetRequest(session))
    assert not core._pool.tasks["blocks.scatter"].has_expert

    with pytest.raises(Unimplemented, match="must have a scripted expert"):
        await core.expert_actions(ExpertActionsRequest(session))
    with pytest.raises(Unimplemented, match="must have a scripted expert"):
        await anext(core.demonstrate(DemonstrateRequest("blocks.scatter", "expert")))


async def test_without_recipes_the_expert_follows_the_one_displayed() -> None:
    with closing(VectorEnv(GRID, num_envs=4, seed=0, privileged=True)) as envs:
        envs.reset()
        successes = np.zeros(4, bool)
        for _ in range(GRID.spec.max_episode_steps):
            truth = envs.step(envs.expert_actions().actions).truth
            assert truth is not None
            successes |= truth.success
        assert successes.all()


async def test_an_expert_that_has_finished_stays_so_until_the_next_episode() -> None:
    recipe = Recipe(("pick-red",))
    with closing(VectorEnv(GRID, num_envs=1, seed=0)) as envs:
        envs.reset()
        assert run_expert(envs, recipe, steps=20).tolist() == [True]
        assert envs.expert_actions((Recipe(("pick-blue",)),)).actions.tolist() == [[0]]
        envs.reset()
        assert envs.expert_actions((Recipe(("pick-blue",)),)).finished.tolist() == [False]


async def test_an_expert_starts_anew_after_a_restore_and_changes_no_later_episode() -> None:
    with closing(VectorEnv(GRID, num_envs=1, seed=0)) as envs, closing(VectorEnv(GRID, num_envs=1, seed=0)) as idle:
        envs.reset()
        idle.reset()
        snapshot = envs.snapshot()
        first = [envs.expert_actions().actions.item() for _ in range(3)]
        envs.restore(snapshot)
        assert [envs.expert_actions().actions.item() for _ in range(3)] == first
        envs.reset()
        idle.reset()
        assert envs.snapshot() == idle.snapshot()
