"""The RPCs `Check` and `ExpertActions`, without a service."""

from contextlib import closing

import numpy as np
import numpy.typing as npt
import pytest

from freerein.errors import FailedPrecondition, InvalidInput, Unimplemented
from freerein.types.sim import CheckRequest, DemonstrateRequest, Recipe
from freerein_sim.workers.checks import check
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import blocks, doom, grid, rope

GRID, SCATTER, ROPE = grid.TASKS[0], blocks.TASKS[1], rope.TASKS[0]
STATES = np.zeros((2, 3, 12))
RED = Recipe(("pick-red",))


def run_expert(envs: VectorEnv, *recipes: Recipe, steps: int) -> npt.NDArray[np.bool_]:
    """Lets the experts act for a number of steps; returns which have finished then."""
    for _ in range(steps):
        envs.step(envs.expert_actions(recipes).actions)
    return envs.expert_actions(recipes).finished


def test_a_predicate_judges_each_state() -> None:
    states = STATES.copy()
    states[1, 2, 2:4] = -1  # red is gone

    response = check(GRID, CheckRequest("", "completed/pick-red", states))

    assert response.holds is not None
    assert response.values is None
    assert response.holds.dtype == np.bool_
    assert response.holds.tolist() == [[False] * 3, [False, False, True]]


def test_states_are_compared_with_references() -> None:
    references = STATES.copy()
    references[0, 1] = 1

    response = check(GRID, CheckRequest("", "at-landmark", STATES, references))

    assert response.holds is not None
    assert response.holds.tolist() == [[True, False, True], [True] * 3]


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"predicate": ""}, "predicate"),
        ({"states": STATES[0]}, "states"),
        ({"states": STATES[..., :-1]}, "states"),
        ({"states": STATES.astype(np.float32)}, "states"),
        ({"states": STATES[:0]}, "states"),
        ({"states": np.broadcast_to(0.0, (1_000_001, 1, 12))}, "states"),
        ({"states": np.full_like(STATES, np.nan)}, "states"),
        ({"references": None}, "references"),
        ({"references": STATES[:1]}, "references"),
        ({"references": np.full_like(STATES, np.inf)}, "references"),
        ({"predicate": "completed/pick-red"}, "references"),
    ],
)
def test_a_check_that_does_not_fit_is_refused(fields: dict[str, object], field: str) -> None:
    request = {"predicate": "at-landmark", "states": STATES, "references": STATES, **fields}

    with pytest.raises(InvalidInput) as caught:
        check(GRID, CheckRequest("", **request))

    assert caught.value.field == field
    assert caught.value.hint


def test_an_unknown_predicate_is_answered_by_those_there_are() -> None:
    with pytest.raises(InvalidInput) as caught:
        check(GRID, CheckRequest("", "no-such", STATES))

    assert "at-landmark, object-moves, completed/pick-red" in caught.value.hint


def test_a_measure_is_a_number_of_each_state() -> None:
    line = np.zeros((26, 3))
    line[:, 0] = np.linspace(-0.3, 0.3, 26)
    bent, turned = line + np.abs(line[:, [1, 0, 1]]), line[:, [1, 0, 2]]
    states = np.stack([line, turned, bent]).reshape(1, 3, -1)
    references = np.broadcast_to(line.reshape(-1), states.shape)

    response = check(ROPE, CheckRequest("", "tps-rpm", states, references))

    assert response.holds is None
    assert response.values is not None
    assert response.values.dtype == np.float64
    np.testing.assert_allclose(response.values[0, :2], 0, atol=1e-5)
    assert response.values[0, 2] > 0.02
    assert [(each.name, each.unit) for each in ROPE.describe().measures] == [("tps-rpm", "m")]


def test_a_measure_refuses_what_is_no_rope_and_takes_one_that_is_a_point() -> None:
    point = np.zeros((1, 1, 78))
    for many, field in ((np.zeros((33, 1, 78)), "states"), (np.full((1, 1, 78), 1e200), "states")):
        with pytest.raises(InvalidInput) as caught:
            check(ROPE, CheckRequest("", "tps-rpm", many, many))
        assert caught.value.field == field
    values = check(ROPE, CheckRequest("", "tps-rpm", point, point)).values
    assert values is not None
    assert values.tolist() == [[0.0]]


def test_random_exploration_is_the_tasks_own_and_changes_no_later_episode() -> None:
    assert doom.TASKS[0].describe().has_explorer
    assert not GRID.describe().has_explorer
    with closing(VectorEnv(ROPE, num_envs=1, seed=0)) as envs, closing(VectorEnv(ROPE, num_envs=1, seed=0)) as idle:
        envs.reset()
        idle.reset()
        first = envs.expert_actions(behaviour="random")
        assert first.skills.tolist() == [-1]
        assert not first.finished.any()
        for each in (envs, idle):
            each.step(first.actions)
        assert not np.array_equal(envs.expert_actions(behaviour="random").actions, first.actions)
        envs.reset()
        idle.reset()
        assert envs.snapshot() == idle.snapshot()


def test_the_expert_needs_an_episode_and_recipes_that_fit() -> None:
    with closing(VectorEnv(GRID, num_envs=2, seed=3)) as envs:
        with pytest.raises(FailedPrecondition, match="ExpertActions needs episodes"):
            envs.expert_actions()
        envs.reset()
        for recipes in ((Recipe(()),), (Recipe(()), Recipe(("no-such-skill",)))):
            with pytest.raises(InvalidInput) as caught:
                envs.expert_actions(recipes)
            assert caught.value.field == "recipes"


def test_a_task_without_an_expert_says_so() -> None:
    assert not SCATTER.describe().has_expert
    with closing(VectorEnv(SCATTER, num_envs=1, seed=0)) as envs, closing(SCATTER.make()) as world:
        envs.reset()
        with pytest.raises(Unimplemented, match="must have a scripted expert"):
            envs.expert_actions()
        with pytest.raises(Unimplemented, match="must have a scripted expert"):
            make_demonstration(SCATTER, world, DemonstrateRequest("blocks.scatter", "expert"))


def test_without_recipes_the_expert_follows_the_one_displayed() -> None:
    with closing(VectorEnv(GRID, num_envs=4, seed=0, privileged=True)) as envs:
        envs.reset()
        successes = np.zeros(4, bool)
        for _ in range(GRID.spec.max_episode_steps):
            truth = envs.step(envs.expert_actions().actions).truth
            assert truth is not None
            successes |= truth.success
        assert successes.all()


def test_an_expert_that_has_finished_stays_so_until_the_next_episode() -> None:
    with closing(VectorEnv(GRID, num_envs=1, seed=0)) as envs:
        envs.reset()
        assert run_expert(envs, RED, steps=20).tolist() == [True]
        assert envs.expert_actions((Recipe(("pick-blue",)),)).actions.tolist() == [[0]]
        envs.reset()
        assert envs.expert_actions((Recipe(("pick-blue",)),)).finished.tolist() == [False]


def test_an_expert_starts_anew_after_a_restore_and_changes_no_later_episode() -> None:
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
