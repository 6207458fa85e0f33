from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
import pytest

from freerein.types.common import ActionSpec
from freerein.types.sim import DemonstrateRequest
from freerein_sim.workers.demonstrations import make_demonstration
from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.episodes import RecordedEpisode, record_episode
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.repeated_choices import RepeatedChoices, Repeats
from freerein_sim.worlds.world import NO_SKILL, LabelledAction, TaskDefinition


def explore(task: TaskDefinition, *, seed: int, max_steps: int, cameras: tuple[str, ...] = ()) -> RecordedEpisode:
    rng = np.random.default_rng(seed)
    with closing(task.make()) as world:
        world.reset(rng)
        policy = SmoothRandomPolicy(task.spec.action, rng)
        views = [camera for camera in task.spec.cameras if camera.name in cameras]
        return record_episode(world, policy, cameras=views, max_steps=max_steps)


def test_a_frame_is_seen_before_its_action() -> None:
    task, rng = grid.TASKS[0], np.random.default_rng(0)
    world = task.make()
    world.reset(rng, recipe=("pick-red",))
    first = world.render("top", height=33, width=30)
    expert = world.expert(("pick-red",), rng)

    shown = record_episode(world, expert, cameras=grid.SPEC.cameras, max_steps=50)

    assert np.array_equal(shown.frames["top"][0], first)
    assert shown.actions[-1].item() == grid.PICK_UP
    assert len(shown.frames["top"]) == len(shown.actions) == len(shown.labels)
    assert shown.terminated.tolist() == [False] * (len(shown.actions) - 1) + [True]


def test_every_camera_asked_for_is_recorded() -> None:
    shown = explore(blocks.TASKS[0], seed=0, max_steps=3, cameras=("left", "front"))

    assert {camera: frames.shape for camera, frames in shown.frames.items()} == {
        "left": (3, 64, 64, 3),
        "front": (3, 64, 64, 3),
    }
    assert shown.actions.dtype == np.float32
    assert shown.actions.shape == (3, 3)


def test_a_demonstration_of_no_steps_has_the_right_shapes() -> None:
    shown = explore(grid.TASKS[0], seed=0, max_steps=0, cameras=("top",))

    assert shown.frames["top"].shape == (0, 33, 30, 3)
    assert shown.actions.shape == (0, 1)
    assert shown.labels.shape == shown.terminated.shape == (0,)
    assert shown.terminated.dtype == np.bool_


def test_a_demonstration_cut_short_is_no_success() -> None:
    task, rng = blocks.TASKS[0], np.random.default_rng(0)
    with closing(task.make()) as world:
        world.reset(rng)
        expert = world.expert(("move-red",), rng)
        shown = record_episode(world, expert, cameras=(), max_steps=10)

    assert len(shown.actions) == 10
    assert not shown.success
    assert not shown.terminated.any()


@pytest.mark.parametrize("task", [grid.TASKS[0], blocks.TASKS[0]], ids=["discrete", "continuous"])
def test_exploration_has_no_skill_and_depends_on_its_generator_only(task: TaskDefinition) -> None:
    first, again, other = (explore(task, seed=seed, max_steps=20) for seed in (0, 0, 1))

    assert set(first.labels.tolist()) == {NO_SKILL}
    assert np.array_equal(first.actions, again.actions)
    assert not np.array_equal(first.actions, other.actions)


def test_exploration_is_smooth_and_reaches_the_limits() -> None:
    policy = SmoothRandomPolicy(blocks.TASKS[0].spec.action, np.random.default_rng(0))
    actions = np.array([policy.act().action for _ in range(1000)])

    assert np.abs(np.diff(actions, axis=0)).max() <= 1.0
    assert np.abs(actions).max() <= 1.0
    assert (actions.max(axis=0) > 0.95).all()
    assert (actions.min(axis=0) < -0.95).all()


@dataclass
class Walk:
    """Explores until its manoeuvre begins."""

    steps: int

    def act(self) -> LabelledAction | None:
        self.steps -= 1
        return None if self.steps < 0 else LabelledAction(np.array([self.steps % 4], np.int64), NO_SKILL)

    def succeeded(self) -> bool:
        return True


def test_a_task_names_its_explorer_and_a_trajectory_ends_where_a_manoeuvre_begins() -> None:
    task = replace(grid.TASKS[0], explorer=lambda _world, rng: Walk(int(rng.integers(1, 6))))
    lengths = []
    with closing(task.make()) as world:
        for first in range(12):
            request = DemonstrateRequest(task.name, "random", count=12, seed=0, first=first)
            walked = make_demonstration(task, world, request).trajectory
            assert walked.actions[:, 0].tolist() == [step % 4 for step in reversed(range(len(walked.actions)))]
            assert walked.terminated is not None
            assert not walked.terminated.any()
            lengths.append(len(walked.actions))
    assert 3 < len(set(lengths)) <= 5


def test_random_choices_are_repeated_as_often_as_is_said() -> None:
    action = ActionSpec(1, 3, ("rest", "walk", "turn"))
    policy = RepeatedChoices((Repeats(0.2, 1), Repeats(0.8, 4), Repeats(0.0, 9)), action, np.random.default_rng(0))
    chosen = np.array([policy.act().action.item() for _ in range(20_000)])
    assert set(chosen.tolist()) == {0, 1}
    assert np.mean(chosen == 0) == pytest.approx(0.2 / (0.2 + 0.8 * 2.5), abs=0.01)  # a walk takes 2.5 steps
    with pytest.raises(ValueError, match="each of 4 choices; got 1"):
        RepeatedChoices((Repeats(1, 1),), ActionSpec(1, 4, tuple("abcd")), np.random.default_rng(0))
