"""Pictures for reward models: two to four blocks, anywhere, and the others where nobody sees them."""

from collections import Counter
from contextlib import closing
from functools import cache
from itertools import combinations

import mujoco
import numpy as np
import pytest

from freerein_sim.worlds.blocks import TASKS, initial_states, scene
from freerein_sim.worlds.blocks.goals import GOAL_RELATIONS
from freerein_sim.worlds.blocks.relations import BLOCK_M, holds, is_visible
from freerein_sim.worlds.blocks.spec import COLOURS
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.rendering import open_renderer
from freerein_sim.worlds.world import Frame, World

TASK = next(task for task in TASKS if task.name == "blocks.scatter")
SEEDS = 300
CAMERAS = [camera.name for camera in TASK.spec.cameras]


@cache
def draw(states: int, *, count: int) -> list[initial_states.InitialState]:
    rng = np.random.default_rng(0)
    return [initial_states.scatter(rng, fewest=count, most=count) for _ in range(states)]


def on_show(blocks: np.ndarray) -> tuple[int, ...]:
    """Returns which blocks are not parked, from their centres, (4, 3)."""
    return tuple(np.flatnonzero(is_visible(blocks)).tolist())


def shown(start: initial_states.InitialState) -> np.ndarray:
    return start.blocks[list(on_show(start.blocks))]


def begin(seed: int) -> World:
    world = TASK.make()
    world.reset(np.random.default_rng(seed))
    return world


def look_without_parked(state: np.ndarray, camera: str, *, height: int, width: int) -> Frame:
    """Draws a true state in the scene of a goal task, which has neither the parked blocks nor the pad."""
    poses = state[3:].reshape(len(COLOURS), 7)
    visible = on_show(poses)
    model = scene.build(tuple(COLOURS[i] for i in visible)).model
    data = mujoco.MjData(model)
    data.joint("gripper.y").qpos, data.joint("gripper.z").qpos = state[:2]
    data.joint("finger.left").qpos = data.joint("finger.right").qpos = state[2] / 2
    for i in visible:
        data.joint(COLOURS[i]).qpos = poses[i]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    with closing(open_renderer(model)) as renderer:
        return renderer.render(data, camera, height=height, width=width)


def test_two_three_and_four_blocks_are_on_show_equally_often() -> None:
    rng = np.random.default_rng(0)
    drawn = Counter(len(shown(initial_states.scatter(rng))) for _ in range(1200))

    assert set(drawn) == {2, 3, 4}
    assert all(0.9 < count / 400 < 1.1 for count in drawn.values())


def test_every_pair_of_colours_is_on_show_equally_often() -> None:
    drawn = Counter(on_show(start.blocks) for start in draw(3000, count=2))

    assert set(drawn) == set(combinations(range(len(COLOURS)), 2))
    assert all(0.9 < count / 500 < 1.1 for count in drawn.values())


@pytest.mark.parametrize(("height", "width"), [(256, 256), (8, 256)], ids=["square", "as wide as can be"])
@pytest.mark.parametrize("camera", CAMERAS)
def test_pictures_are_those_of_the_blocks_on_show_alone_to_the_bit(camera: str, height: int, width: int) -> None:
    for seed in range(2):
        with closing(begin(seed)) as world:
            seen = world.render(camera, height=height, width=width)
            state = world.truth().state

        assert np.array_equal(seen, look_without_parked(state, camera, height=height, width=width))


def test_the_relations_of_the_goal_tasks_and_blocks_in_hand_occur_often() -> None:
    drawn = draw(3000, count=2)
    seen = Counter(
        relation
        for start in drawn
        for first, second in (shown(start), shown(start)[::-1])
        for relation in GOAL_RELATIONS
        if holds(relation, first, second)
    )
    in_hand = sum(start.gripper.target_m < start.gripper.finger_m for start in drawn)

    assert all(seen[relation] > 0.05 * len(drawn) for relation in GOAL_RELATIONS)
    assert 0.2 < in_hand / len(drawn) < 0.3


@pytest.mark.parametrize("count", [2, 3, 4])
def test_nothing_begins_inside_anything_else(count: int) -> None:
    model = scene.build(COLOURS, pad=True).model
    data = mujoco.MjData(model)
    for start in draw(SEEDS, count=count):
        assert is_visible(start.blocks).sum() == count
        for colour, place in zip(COLOURS, start.blocks, strict=True):
            data.joint(colour).qpos = (*place, 1, 0, 0, 0)
        data.joint("gripper.y").qpos, data.joint("gripper.z").qpos = start.gripper.at
        data.joint("finger.left").qpos = data.joint("finger.right").qpos = start.gripper.finger_m
        mujoco.mj_forward(model, data)

        assert data.contact.dist.min(initial=0.0) > -1e-6


def test_blocks_are_where_the_gripper_works_and_half_are_near_one_another() -> None:
    pairs = np.stack([shown(start) for start in draw(3000, count=2)])
    distances = np.linalg.norm(pairs[:, 0] - pairs[:, 1], axis=1)

    assert (pairs[..., 0] == 0).all()
    assert (np.abs(pairs[..., 1]) <= 0.2).all()
    assert (pairs[..., 2] >= BLOCK_M / 2).all()
    assert (pairs[..., 2] <= 0.2).all()
    assert (distances < 2.5 * BLOCK_M + 1e-9).mean() > 0.5


def test_parked_blocks_stay_where_they_are_and_end_no_episode() -> None:
    moved = []
    for seed in range(40):
        with closing(begin(seed)) as world:
            policy = SmoothRandomPolicy(TASK.spec.action, np.random.default_rng(seed))
            for _ in range(TASK.spec.max_episode_steps):
                outcome = world.step(policy.act().action)
            blocks = world.truth().state[3:].reshape(len(COLOURS), 7)[:, :3]
            parked = [i for i in range(len(COLOURS)) if i not in on_show(blocks)]

        assert not outcome.terminated
        moved.append(blocks[parked] - initial_states.PARKED_M[parked])
    assert np.abs(np.concatenate(moved)).max() < 0.001


def test_a_held_block_stays_in_the_hand_that_does_nothing() -> None:
    start, seed = next(
        (start, seed)
        for seed in range(100)
        if (start := initial_states.scatter(np.random.default_rng(seed))).gripper.target_m < start.gripper.finger_m
        and shown(start)[:, 2].min() > 0.1
    )
    with closing(begin(seed)) as world:
        for _ in range(TASK.spec.max_episode_steps):
            world.step(np.zeros(3, np.float32))
        heights = world.truth().state[3:].reshape(len(COLOURS), 7)[list(on_show(start.blocks)), 2]

    assert np.abs(heights - shown(start)[:, 2]).min() < 0.01
    assert heights.min() == pytest.approx(BLOCK_M / 2, abs=0.01)
