"""A vector of environments, in process."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from freerein.errors import FailedPrecondition, InvalidInput, ServiceError
from freerein.types.sim import StepResponse
from freerein_sim.workers import snapshots
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.grid import GridWorld
from freerein_sim.worlds.world import Action, StepResult, TaskDefinition

TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS)}
GRID, BLOCKS = TASKS["grid"], TASKS["blocks"]
MakeEnvs = Callable[..., VectorEnv]


class Fragile(GridWorld):
    """A world that diverges when it is told to pick up."""

    def step(self, action: Action) -> StepResult:
        diverged = int(action[0]) == grid.PICK_UP
        return StepResult(terminated=diverged, diverged=diverged) if diverged else super().step(action)


FRAGILE = TaskDefinition("fragile", "grid", "", grid.SPEC, lambda: Fragile(indicator=True))


@pytest.fixture
def make() -> Iterator[MakeEnvs]:
    """A function that makes environments, closed with the test; not yet reset."""
    made: list[VectorEnv] = []

    def make_envs(task: TaskDefinition = GRID, *, num_envs: int = 3, seed: int = 7, **options: int) -> VectorEnv:
        made.append(VectorEnv(task, num_envs=num_envs, seed=seed, **options))
        return made[-1]

    yield make_envs
    for envs in made:
        envs.close()


@pytest.fixture
def begin(make: MakeEnvs) -> MakeEnvs:
    """As `make`, and reset."""

    def begin_envs(*args: TaskDefinition, **options: int) -> VectorEnv:
        envs = make(*args, **options)
        envs.reset()
        return envs

    return begin_envs


def some_actions(task: TaskDefinition, num_envs: int, rng: np.random.Generator) -> np.ndarray:
    spec = task.spec.action
    if spec.choices:
        return rng.integers(spec.choices, size=(num_envs, spec.size))
    return rng.uniform(-1, 1, size=(num_envs, spec.size)).astype(np.float32)


def bits(response: StepResponse) -> tuple[object, ...]:
    flags = (response.terminated, response.truncated, response.diverged)
    frames = [
        (name, part[name].shape, part[name].tobytes())
        for part in (response.frames, response.final_frames)
        for name in part
    ]
    truth = None if response.truth is None else (response.truth.state.tobytes(), response.truth.success.tobytes())
    return response.step_id, *(flag.tobytes() for flag in flags), frames, truth


def test_environment_i_draws_from_child_i_of_the_seed(make: MakeEnvs) -> None:
    frames = make(GRID, num_envs=3, seed=11).reset(cameras=("top",)).frames["top"]

    for child, frame in zip(np.random.SeedSequence(11).spawn(3), frames, strict=True):
        world = GRID.make()
        world.reset(np.random.default_rng(child))
        np.testing.assert_array_equal(frame, world.render("top", height=33, width=30))


def test_an_episode_is_cut_at_its_longest_and_goes_on_as_a_new_one(begin: MakeEnvs) -> None:
    envs = begin(num_envs=2, privileged=True)
    up = np.zeros((2, 1), np.int64)
    for _ in range(GRID.spec.max_episode_steps - 1):
        assert not envs.step(up).truncated.any()
    before = envs.render().frames["top"]

    cut = envs.step(up, ("top",))

    assert cut.truncated.all()
    assert not cut.terminated.any()
    np.testing.assert_array_equal(cut.final_frames["top"], before)  # they stood at the upper edge
    assert (cut.frames["top"] != before).any()
    assert (cut.truth.state[:, 0] == 0).all()  # the truth is of the old episode
    assert not envs.step(up).truncated.any()


def test_a_held_action_is_the_same_action_several_times(begin: MakeEnvs) -> None:
    held, stepped = begin(BLOCKS, num_envs=2, privileged=True), begin(BLOCKS, num_envs=2, privileged=True)
    rng = np.random.default_rng(0)
    for _ in range(3):
        actions = some_actions(BLOCKS, 2, rng)
        for _ in range(3):
            stepped.step(actions)
        last = stepped.step(actions, ("front",))
        assert bits(held.step(actions, ("front",), action_repeat=4))[1:] == bits(last)[1:]
    assert (held.step_id, stepped.step_id) == (3, 12)


def test_an_action_is_held_until_the_episode_ends(begin: MakeEnvs) -> None:
    envs = begin(FRAGILE, max_episode_steps=5)
    down = np.full((3, 1), 1)

    first = envs.step(np.array([[1], [grid.PICK_UP], [1]]), action_repeat=4)
    second = envs.step(down, ("top",), action_repeat=4)

    assert first.terminated.tolist() == [False, True, False]
    assert second.truncated.tolist() == [True, False, True]
    assert len(second.final_frames["top"]) == 2
    assert envs.step(down, action_repeat=4).truncated.tolist() == [False, True, False]


@pytest.mark.parametrize("action_repeat", [0, 65])
def test_an_action_is_held_for_1_to_64_timesteps(begin: MakeEnvs, action_repeat: int) -> None:
    with pytest.raises(InvalidInput, match="action_repeat"):
        begin().step(np.zeros((3, 1), np.int64), action_repeat=action_repeat)


def test_final_frames_are_of_the_ended_episodes_only_in_order(begin: MakeEnvs) -> None:
    envs = begin(FRAGILE)
    before = envs.render().frames["top"]

    response = envs.step(np.array([[grid.PICK_UP], [0], [grid.PICK_UP]]), ("top",))

    assert response.terminated.tolist() == [True, False, True]
    np.testing.assert_array_equal(response.final_frames["top"], before[[0, 2]])


@pytest.mark.fault("M5")
def test_a_world_that_diverges_says_so_and_begins_anew(begin: MakeEnvs) -> None:
    envs = begin(FRAGILE)

    response = envs.step(np.array([[0], [grid.PICK_UP], [0]]))

    assert response.diverged.tolist() == response.terminated.tolist() == [False, True, False]
    assert not envs.step(np.zeros((3, 1), np.int64)).diverged.any()


@pytest.mark.fault("M4")
@pytest.mark.parametrize(
    ("task", "actions"),
    [
        (GRID, np.zeros((3, 1), np.int32)),
        (GRID, np.zeros((2, 1), np.int64)),
        (GRID, np.array([[0], [5], [0]])),
        (BLOCKS, np.zeros((3, 3), np.float64)),
        (BLOCKS, np.full((3, 3), np.nan, np.float32)),
        (BLOCKS, np.full((3, 3), 1.001, np.float32)),
    ],
)
def test_wrong_actions_are_refused_and_change_nothing(
    begin: MakeEnvs, task: TaskDefinition, actions: np.ndarray
) -> None:
    envs = begin(task)
    before = envs.snapshot()

    with pytest.raises(InvalidInput, match=r"`actions` must be .* finite and within .*; got .*"):
        envs.step(actions)

    assert envs.snapshot() == before


@pytest.mark.parametrize("measured", [np.ones((1, 3), np.int64), np.full((1, 3), 1.0000001, np.float32)])
def test_actions_may_be_whole_numbers_and_a_hair_outside(begin: MakeEnvs, measured: np.ndarray) -> None:
    exact = begin(BLOCKS, num_envs=1).step(np.ones((1, 3), np.float32), ("front",))
    assert bits(begin(BLOCKS, num_envs=1).step(measured, ("front",))) == bits(exact)


@pytest.mark.parametrize("cameras", [("nowhere",), ("top", "nowhere")])
def test_a_camera_that_there_is_not_is_refused_before_the_step(begin: MakeEnvs, cameras: Sequence[str]) -> None:
    envs = begin()
    before = envs.snapshot()

    with pytest.raises(InvalidInput, match="cameras"):
        envs.step(np.zeros((3, 1), np.int64), cameras)

    assert envs.snapshot() == before


def test_a_size_that_the_world_cannot_render_is_refused_before_the_step(make: MakeEnvs) -> None:
    envs = make(GRID, num_envs=1, seed=0, height=20)
    envs.reset()
    before = envs.snapshot()

    with pytest.raises(InvalidInput, match="33 x 30"):
        envs.step(np.zeros((1, 1), np.int64), ("top",))

    assert envs.snapshot() == before


def test_what_was_never_reset_cannot_step_render_or_be_saved(make: MakeEnvs) -> None:
    envs = make(GRID, num_envs=2, seed=0)

    for call in (lambda: envs.step(np.zeros((2, 1), np.int64)), envs.render, envs.snapshot, lambda: envs.reset([1])):
        with pytest.raises(FailedPrecondition, match="reset"):
            call()


@pytest.mark.parametrize("envs", [(3,), (-1,), (0, 0)])
def test_a_reset_names_environments_that_there_are_each_once(begin: MakeEnvs, envs: Sequence[int]) -> None:
    with pytest.raises(InvalidInput, match="0 to 2, each once"):
        begin().reset(envs)


def test_a_reset_of_some_leaves_the_others_as_they_are(begin: MakeEnvs) -> None:
    envs = begin()
    before = envs.render().frames["top"]

    after = envs.reset([1], cameras=("top",)).frames["top"]

    assert (after != before).any(axis=(1, 2, 3)).tolist() == [False, True, False]


def test_a_reset_with_a_seed_begins_as_a_new_session_does(begin: MakeEnvs, make: MakeEnvs) -> None:
    envs = begin(seed=1)

    again = envs.reset(seed=5, cameras=("top",)).frames["top"]

    np.testing.assert_array_equal(again, make(GRID, num_envs=3, seed=5).reset(cameras=("top",)).frames["top"])


def test_only_the_privileged_see_the_truth_and_nobody_gets_its_reward_as_reward(begin: MakeEnvs) -> None:
    actions = np.zeros((3, 1), np.int64)
    plain, privileged = begin(), begin(privileged=True)

    assert plain.reset().truth is None
    assert plain.step(actions).truth is None
    response = privileged.step(actions)
    assert response.truth is not None
    assert response.truth.state.shape == (3, len(GRID.spec.state_names))
    assert response.reward.dtype == np.float32
    assert not response.reward.any()


@pytest.mark.fault("M10")
@pytest.mark.parametrize(("task", "count"), [(GRID, 29), (BLOCKS, 3)], ids=["grid", "blocks"])
def test_restored_at_any_cut_the_same_actions_give_the_same_bits(
    begin: MakeEnvs, make: MakeEnvs, task: TaskDefinition, count: int
) -> None:
    rng = np.random.default_rng(0)
    actions = [some_actions(task, 2, rng) for _ in range(60)]
    cuts = set(rng.choice(60, size=count, replace=False).tolist())
    envs, kept, seen = begin(task, num_envs=2, privileged=True), {}, []
    for i, action in enumerate(actions):
        if i in cuts:
            kept[i] = envs.snapshot()
        seen.append(bits(envs.step(action, (task.spec.cameras[0].name,))))

    for i, snapshot in kept.items():
        other = make(task, num_envs=2, seed=99, privileged=True)
        other.restore(snapshot)
        assert [bits(other.step(action, (task.spec.cameras[0].name,))) for action in actions[i:]] == seen[i:]


@pytest.mark.fault("M10")
def test_a_snapshot_without_its_last_or_with_another_byte_is_refused(begin: MakeEnvs) -> None:
    envs = begin()
    snapshot = envs.snapshot()

    for damaged in (b"", snapshot[:-1], snapshot + b"\0", snapshot[:40] + b"!" + snapshot[41:], snapshot[:32]):
        with pytest.raises(InvalidInput, match=r"do not match their hash|cannot be read"):
            envs.restore(damaged)
    assert envs.snapshot() == snapshot


@pytest.mark.fault("M10")
@settings(max_examples=30, database=None)
@given(data=st.data())
def test_a_forged_snapshot_is_refused_and_changes_nothing_or_is_a_state(data: st.DataObject) -> None:
    envs = VectorEnv(GRID, num_envs=2, seed=0)
    envs.reset()
    snapshot = envs.snapshot()
    body = bytearray(snapshot[32:])
    for _ in range(data.draw(st.integers(1, 3))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))

    try:
        envs.restore(hashlib.sha256(body).digest() + bytes(body))
    except ServiceError:
        assert envs.snapshot() == snapshot
    envs.step(np.zeros((2, 1), np.int64), ("top",))


@pytest.mark.fault("M10")
def test_a_snapshot_of_another_task_build_or_number_is_refused(begin: MakeEnvs) -> None:
    envs = begin()
    ours = snapshots.decode(envs.snapshot())
    foreign = [
        (begin(TASKS["grid-no-indicator"]).snapshot(), "the task grid-no-indicator"),
        (begin(num_envs=2).snapshot(), "2 environments"),
        (snapshots.encode(replace(ours, fingerprint="another build")), "another build or other conditions"),
    ]

    for snapshot, got in foreign:
        with pytest.raises(FailedPrecondition, match=f"of this session's task, build and conditions.*got one of {got}"):
            envs.restore(snapshot)


def test_a_size_beyond_the_cameras_is_refused_at_once(make: MakeEnvs) -> None:
    with pytest.raises(InvalidInput, match="321"):
        make(BLOCKS, num_envs=1, seed=0, height=321)


def test_frames_have_the_size_asked_for(make: MakeEnvs) -> None:
    envs = make(BLOCKS, num_envs=2, seed=0, height=48, width=40)

    frames = envs.reset(cameras=("left", "front")).frames

    assert {name: frame.shape for name, frame in frames.items()} == {"left": (2, 48, 40, 3), "front": (2, 48, 40, 3)}
    assert envs.render(("tilt",), height=16, width=24).frames["tilt"].shape == (2, 16, 24, 3)
