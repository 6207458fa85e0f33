from contextlib import closing

import numpy as np
import numpy.typing as npt
import pytest

from freerein_sim.worlds.bins import TASKS, initial_states, scene
from freerein_sim.worlds.bins.arm import HOME_RAD, Arm
from freerein_sim.worlds.bins.layout import FLOOR_M, GROCERIES, LEFT_BIN_HALF_M, LEFT_BIN_M, WALL_TOP_M, Grocery
from freerein_sim.worlds.bins.simulation import BinsWorld
from freerein_sim.worlds.bins.spec import GRIPPER_STEP_M, SPEC
from freerein_sim.worlds.predicates import States

TASK = TASKS[0]
COMPLETED = {each.name: each for each in TASK.predicates if each.name.startswith("completed/")}
BY_NAME = {each.name: each for each in GROCERIES}
OPEN_M = 0.079


def begin(seed: int = 0) -> BinsWorld:
    world = TASK.make()
    assert isinstance(world, BinsWorld)
    world.reset(np.random.default_rng(seed))
    return world


def moved(dx: float, dy: float, dz: float, *, fingers: float) -> npt.NDArray[np.float32]:
    """Returns the action that moves the set-point by metres."""
    return np.array([*np.array([dx, dy, dz]) / GRIPPER_STEP_M, fingers], np.float32)


def two_states(grocery: Grocery, at: tuple[float, float, float], *, opening_m: float) -> States:
    """Returns states in which a grocery begins in the left bin and ends elsewhere, where the gripper grips it."""
    states = np.zeros((1, 2, len(SPEC.state_names)))
    first = SPEC.state_names.index(f"{grocery.name}.x")
    states[0, 0, first : first + 3] = (*LEFT_BIN_M, FLOOR_M + grocery.below_m)
    states[0, 1, first : first + 3] = at
    states[0, 1, :4] = (*np.add(at, (0, 0, grocery.grip_m)), opening_m)
    return states


@pytest.mark.parametrize("grocery", GROCERIES, ids=[each.name for each in GROCERIES])
def test_the_arm_reaches_a_grocery_wherever_it_lies_and_its_compartment(grocery: Grocery) -> None:
    arm = Arm(scene.build().model)
    half = np.array(LEFT_BIN_HALF_M) - 0.065
    corners = np.array(LEFT_BIN_M) + half * [[-1, -1], [-1, 1], [1, -1], [1, 1]]
    heights = FLOOR_M + grocery.below_m + grocery.grip_m, 1.1

    for x, y in (*corners, grocery.compartment_m):
        for z in heights:
            place = np.array([x, y, z])
            assert np.abs(arm.reach(arm.solve(place, HOME_RAD)) - place).max() < 0.001


def test_a_place_out_of_reach_leaves_the_arm_where_it_is() -> None:
    arm = Arm(scene.build().model)

    assert (arm.solve(np.array([3.0, 0.0, 1.0]), HOME_RAD) == HOME_RAD).all()


def test_groceries_begin_upright_and_apart_in_the_left_bin_whatever_the_recipe() -> None:
    starts = [initial_states.draw(np.random.default_rng(seed)).poses for seed in range(50)]
    places = np.stack(starts)[..., :2]  # (50, 4, 2)
    gaps = np.abs(places[:, :, None] - places[:, None])[:, *np.triu_indices(len(GROCERIES), 1)].max(axis=-1)

    assert (np.abs(places - LEFT_BIN_M) < LEFT_BIN_HALF_M).all()
    assert gaps.min() > 0.11
    with closing(begin()) as world:
        snapshots = set()
        for recipe in ((), ("move-milk",), ("move-can", "move-bread")):
            world.reset(np.random.default_rng(3), recipe=recipe)
            snapshots.add(world.snapshot())
    assert len(snapshots) == 1


def test_the_gripper_follows_its_set_point_and_does_not_wind_up_against_the_floor() -> None:
    with closing(begin()) as world:
        before = world.set_point
        for _ in range(2):
            world.step(moved(-0.02, 0.01, 0.02, fingers=0))
        moved_by = world.set_point - before
        for _ in range(3):
            world.step(moved(0, 0, 0, fingers=0))
        settled = np.abs(world.gripper - world.set_point).max()
        for _ in range(8):
            world.step(moved(0, 0, -GRIPPER_STEP_M, fingers=0))

        assert moved_by == pytest.approx([-0.04, 0.02, 0.04], abs=0.002)
        assert settled < 0.002
        assert world.set_point[2] > FLOOR_M


def test_friction_alone_holds_a_grocery_until_the_fingers_open() -> None:
    rng = np.random.default_rng(5)
    milk = BY_NAME["milk"]
    with closing(begin(5)) as world:
        expert = world.expert(("move-milk",), rng)
        while world.position(milk)[2] < WALL_TOP_M + milk.below_m:
            action = expert.act()
            assert action is not None
            world.step(action.action)
        for _ in range(5):
            world.step(moved(0, 0, 0, fingers=-1))
        held = world.gripper - world.position(milk)
        opening_m = world.opening_m
        for _ in range(4):
            world.step(moved(0, 0, 0, fingers=1))

        assert held == pytest.approx([0, 0, milk.grip_m], abs=0.02)
        assert opening_m == pytest.approx(milk.width_m, abs=0.003)
        assert world.position(milk)[2] < FLOOR_M + milk.below_m + 0.01


def test_picks_last_longer_than_places_and_four_fit_into_an_episode() -> None:
    picking, placing, lifted = 0, 0, set()
    with closing(begin()) as world:
        expert = world.expert((), np.random.default_rng(0))
        while (labelled := expert.act()) is not None:
            grocery = GROCERIES[labelled.skill]
            if world.position(grocery)[2] > FLOOR_M + grocery.below_m + 0.05:
                lifted.add(grocery)
            placing += grocery in lifted
            picking += grocery not in lifted
            world.step(labelled.action)

        assert expert.succeeded()
    assert picking + placing <= SPEC.max_episode_steps
    assert picking > 1.5 * placing


@pytest.mark.parametrize("grocery", GROCERIES, ids=[each.name for each in GROCERIES])
def test_a_skill_is_completed_where_its_grocery_lies_released_in_its_own_compartment(grocery: Grocery) -> None:
    holds = COMPLETED[f"completed/move-{grocery.name}"].holds
    low = FLOOR_M + grocery.below_m
    there = (*grocery.compartment_m, low)
    others = [each.compartment_m for each in GROCERIES if each is not grocery]

    assert holds(two_states(grocery, there, opening_m=OPEN_M)).tolist() == [[False, True]]
    assert not holds(two_states(grocery, there, opening_m=grocery.width_m)).any()
    assert not holds(two_states(grocery, (*grocery.compartment_m, low + 0.02), opening_m=OPEN_M)).any()
    assert not any(holds(two_states(grocery, (*at, low), opening_m=OPEN_M)).any() for at in (*others, LEFT_BIN_M))
    assert not holds(two_states(grocery, there, opening_m=OPEN_M)[:, ::-1]).any()
