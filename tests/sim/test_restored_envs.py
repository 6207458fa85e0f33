"""Single environments of a vector, set to states of a snapshot."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace

import numpy as np
import pytest

from freerein.errors import FailedPrecondition, InvalidInput, ServiceError
from freerein.types.sim import Recipe, StepResponse
from freerein_sim.workers import snapshots
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.world import TaskDefinition

pytestmark = pytest.mark.fault("M10")

TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS)}
GRID, BLOCKS = TASKS["grid"], TASKS["blocks"]
MAX_STEPS = 12
BeginEnvs = Callable[..., VectorEnv]


@pytest.fixture
def begin() -> Iterator[BeginEnvs]:
    """A function that makes environments and resets them; closed with the test."""
    with ExitStack() as opened:

        def begin_envs(task: TaskDefinition = GRID, *, num_envs: int = 3, max_steps: int = MAX_STEPS) -> VectorEnv:
            made = VectorEnv(task, num_envs=num_envs, seed=num_envs, privileged=True, max_episode_steps=max_steps)
            envs = opened.enter_context(closing(made))
            envs.reset()
            return envs

        yield begin_envs


def draw_actions(task: TaskDefinition, num_envs: int, rng: np.random.Generator) -> np.ndarray:
    spec = task.spec.action
    if spec.choices:
        return rng.integers(spec.choices, size=(num_envs, spec.size))
    return rng.uniform(-1, 1, size=(num_envs, spec.size)).astype(np.float32)


def steps(envs: VectorEnv, task: TaskDefinition, count: int, rng: np.random.Generator) -> None:
    for _ in range(count):
        envs.step(draw_actions(task, envs.num_envs, rng))


def bits(response: StepResponse, env: int) -> tuple[object, ...]:
    """Returns an environment's part of a step that ends no episode."""
    assert response.truth is not None
    assert not (response.terminated | response.truncated)[env]
    frames = tuple(frame[env].tobytes() for frame in response.frames.values())
    return *frames, response.truth.state[env].tobytes(), response.truth.success[env]


@pytest.mark.parametrize("task", [GRID, BLOCKS], ids=["grid", "blocks"])
def test_a_restored_env_goes_on_as_its_source_and_then_with_episodes_of_its_own(
    begin: BeginEnvs, task: TaskDefinition
) -> None:
    rng, view = np.random.default_rng(0), (task.spec.cameras[0].name,)
    source, envs, twin = begin(task, num_envs=2), begin(task), begin(task)
    steps(source, task, 8, rng)
    for action in [draw_actions(task, 3, rng) for _ in range(3)]:
        envs.step(action)
        twin.step(action)

    envs.restore(source.snapshot(), [2], [0])

    assert envs.step_id == 3
    for _ in range(MAX_STEPS - 8 - 1):
        actions = draw_actions(task, 3, rng)
        step, expected = envs.step(actions, view), twin.step(actions, view)
        assert bits(step, 2) == bits(source.step(actions[[2, 1]], view), 0)
        assert [bits(step, env) for env in (0, 1)] == [bits(expected, env) for env in (0, 1)]
    actions = draw_actions(task, 3, rng)
    last, expected, final = envs.step(actions, view), twin.step(actions, view), source.step(actions[[2, 1]], view)
    assert last.truncated.tolist() == [False, False, True]
    assert last.final_frames[view[0]][0].tobytes() == final.final_frames[view[0]][0].tobytes()
    own = twin.reset([2], cameras=view).frames[view[0]]
    np.testing.assert_array_equal(last.frames[view[0]], own)
    assert (last.frames[view[0]][2] != final.frames[view[0]][0]).any()
    again = draw_actions(task, 3, rng)
    step, expected = envs.step(again, view), twin.step(again, view)
    assert [bits(step, env) for env in range(3)] == [bits(expected, env) for env in range(3)]


def test_several_envs_take_one_source_of_a_snapshot_of_more_envs(begin: BeginEnvs) -> None:
    saved, envs = begin(num_envs=4), begin()
    steps(saved, GRID, 5, np.random.default_rng(0))

    envs.restore(saved.snapshot(), [2, 0], [3, 3])

    frames = envs.render().frames["top"]
    np.testing.assert_array_equal(frames[[0, 2]], saved.render().frames["top"][[3, 3]])


def test_a_restored_env_has_its_expert_made_anew_and_the_others_keep_theirs(begin: BeginEnvs) -> None:
    envs = begin()
    red, blue = (Recipe((f"pick-{colour}",)) for colour in ("red", "blue"))
    snapshot = envs.snapshot()
    before = envs.expert_actions((red, red, red)).skills

    envs.restore(snapshot, [1], [2])

    after = envs.expert_actions((blue, blue, blue)).skills
    assert (after != before).tolist() == [False, True, False]


def test_only_the_episodes_of_the_sources_must_go_on(begin: BeginEnvs) -> None:
    saved, envs = begin(num_envs=2), begin(max_steps=5)
    rng = np.random.default_rng(0)
    steps(saved, GRID, 5, rng)
    saved.reset([1])
    before = envs.snapshot()

    with pytest.raises(InvalidInput, match="over"):
        envs.restore(saved.snapshot(), [0, 1], [1, 0])

    assert envs.snapshot() == before
    envs.restore(saved.snapshot(), [0, 1], [1, 1])
    assert envs.step(draw_actions(GRID, 3, rng)).truncated.tolist() == [False] * 3


@pytest.mark.parametrize(
    ("envs", "sources", "field"),
    [
        ((3,), (0,), "envs"),
        ((-1,), (0,), "envs"),
        ((0, 0), (0, 1), "envs"),
        ((0,), (2,), "sources"),
        ((0,), (-1,), "sources"),
        ((0, 1), (0,), "sources"),
        ((0,), (), "sources"),
        ((), (0, 1), "sources"),
    ],
)
def test_wrong_indices_are_refused_and_change_nothing(
    begin: BeginEnvs, envs: Sequence[int], sources: Sequence[int], field: str
) -> None:
    held, saved = begin(), begin(num_envs=2)
    before = held.snapshot()

    with pytest.raises(InvalidInput) as refused:
        held.restore(saved.snapshot(), envs, sources)

    assert refused.value.field == field
    assert held.snapshot() == before


@pytest.mark.parametrize(
    ("changes", "world", "error"),
    [
        ({"task": "blocks"}, None, FailedPrecondition),
        ({"fingerprint": "another build"}, None, FailedPrecondition),
        ({}, b"nowhere", InvalidInput),
    ],
)
def test_a_foreign_state_is_refused_and_changes_no_env(
    begin: BeginEnvs, changes: dict[str, str], world: bytes | None, error: type[ServiceError]
) -> None:
    held, saved = begin(), snapshots.decode(begin(num_envs=2).snapshot())
    second = replace(saved.envs[1], world=saved.envs[1].world if world is None else world)
    forged = snapshots.encode(replace(saved, envs=(saved.envs[0], second), **changes))
    before = held.snapshot()

    with pytest.raises(error) as refused:
        held.restore(forged, [0, 2], [0, 1])

    assert "of 3 environments" not in refused.value.detail
    assert held.snapshot() == before


def test_before_the_first_reset_only_the_whole_can_be_restored(begin: BeginEnvs) -> None:
    snapshot = begin().snapshot()
    with closing(VectorEnv(GRID, num_envs=3, seed=0)) as envs:
        with pytest.raises(FailedPrecondition, match="no reset yet"):
            envs.restore(snapshot, [0, 1, 2], [0, 1, 2])
        envs.restore(snapshot)
        assert envs.snapshot() == snapshot
