"""The world `office`."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.worlds.conformance.rollouts import demonstrate
from freerein_sim.worlds.office import TASKS, starts
from freerein_sim.worlds.office.floors import FLOORS
from freerein_sim.worlds.office.furniture import Piece
from freerein_sim.worlds.office.plan import FloorPlan
from freerein_sim.worlds.office.rectangles import distance
from freerein_sim.worlds.office.simulation import OfficeWorld
from freerein_sim.worlds.office.spec import FORWARD, LEFT, LOOP, MAZE, RIGHT, ROBOT_RADIUS_M, STAND_STILL
from freerein_sim.worlds.office.textures.floor_textures import draw_textures
from freerein_sim.worlds.predicates import States
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import World

BY_NAME = {task.name: task for task in TASKS}
PREDICATES = {each.name: each for each in BY_NAME["office"].predicates}
TWO_ROOMS = FloorPlan(seed=1, rows=("aaAb", "aaAB", "aaab"), furniture=(Piece("fridge", 0.4, 0.4),), paths={}, goals={})


@pytest.fixture(scope="module")
def opened() -> Iterator[World]:
    with closing(build(BY_NAME["office"])) as world:
        yield world


def act(world: World, *choices: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Takes actions; returns the distance driven, and the turn, of each: float64 (len(choices), 2)."""
    found = []
    for choice in choices:
        before = world.truth().state
        world.step(np.array([choice]))
        after = world.truth().state
        found.append((np.linalg.norm(after[:2] - before[:2]), starts.turn_deg(before[2], after[2])))
    return np.array(found)


def state(x: float, y: float, heading: float = 0) -> list[float]:
    return [x, y, heading, 0]


def judge(name: str, states: list[list[float]], *references: list[list[float]]) -> list[bool]:
    """Returns where a predicate of the first floor holds in one sequence."""
    arrays: list[States] = [np.array([each]) for each in (states, *references)]
    return PREDICATES[name].holds(*arrays)[0].tolist()


def test_actions_drive_and_turn_by_what_the_seed_draws(opened: World) -> None:
    choices = [LEFT] * 10 + [RIGHT] * 10 + [STAND_STILL]
    opened.reset(np.random.default_rng(0))
    moved = act(opened, *choices)
    opened.reset(np.random.default_rng(0), recipe=[MAZE])
    driven = act(opened, FORWARD, FORWARD)
    opened.reset(np.random.default_rng(0))

    assert np.array_equal(act(opened, *choices), moved)
    assert (moved[:, 0] == 0).all()
    assert (np.abs(moved[:10, 1] - 16) <= 2).all()
    assert (np.abs(moved[10:20, 1] + 16) <= 2).all()
    assert len(set(moved[:20, 1])) == 20
    assert moved[20, 1] == 0
    assert (np.abs(driven[:, 0] - 0.1) <= 0.01).all()
    assert (driven[:, 1] == 0).all()


def test_the_robot_stops_where_it_runs_into_something_and_the_episode_ends(opened: World) -> None:
    opened.reset(np.random.default_rng(2))
    ended = [opened.step(np.array([FORWARD])).terminated for _ in range(120)]
    states = opened.truth().state
    clearance = distance(FLOORS["office"].obstacles, states[None, :2])

    assert ended == sorted(ended)
    assert ended[-1]
    assert ROBOT_RADIUS_M <= clearance < ROBOT_RADIUS_M + 0.011
    assert judge("contact", [[0.0] * 4, states.tolist()]) == [False, True]
    assert act(opened, LEFT).tolist() == [[0, 0]]


@pytest.mark.parametrize("floor", FLOORS)
def test_starts_are_where_the_robot_can_be_and_every_place_can_be_reached_from_them(floor: str) -> None:
    plan, rng = FLOORS[floor], np.random.default_rng(0)
    places = plan.grid.free_places
    poses = np.array([starts.draw_pose(rng, plan) for _ in range(500)])
    reached = plan.grid._next_cells(plan.grid._nearest_cell(places[0]))

    assert (distance(plan.obstacles, poses[:, :2]) >= ROBOT_RADIUS_M).all()
    assert np.histogram(poses[:, 2], 4, (0, 360))[0].min() > 80
    assert len(np.unique(poses[:, :2].round(), axis=0)) > 40  # square metres
    assert len(reached) == len(places)


@pytest.mark.parametrize("floor", FLOORS)
def test_the_expert_reaches_what_is_out_of_view_at_the_start(floor: str) -> None:
    task, plan = BY_NAME[floor], FLOORS[floor]
    judges = {each.name: each.holds for each in task.predicates}
    skills = [*plan.goals, *(5 * [*plan.paths])]
    with closing(build(task)) as world:
        for seed, skill in enumerate(skills):
            shown = demonstrate(world, [skill], np.random.default_rng(seed))
            states, steps = shown.states[None], len(shown.episode.actions)
            seen = starts.pose_along(plan, skill) if skill in plan.paths else np.array(plan.goals[skill])

            assert not starts.overlap(plan.walls, states[0, 0, :3], seen), skill
            assert judges[f"completed/{skill}"](states)[0, -1], skill
            assert not judges["contact"](states)[0, -1], skill
            assert 65 <= steps <= 130 if skill in plan.paths else 15 <= steps <= 35, skill


def test_a_demonstration_may_begin_where_its_path_does() -> None:
    with closing(build(BY_NAME["office.4"], ["heading-along-path"])) as world:
        world.reset(np.random.default_rng(0), recipe=[LOOP])

        assert world.truth().state[:3].tolist() == starts.pose_along(FLOORS["office.4"], LOOP).tolist()


def test_a_recipe_is_one_skill(opened: World) -> None:
    with pytest.raises(InvalidInput, match="is one skill; got maze, loop"):
        opened.reset(np.random.default_rng(0), recipe=[MAZE, LOOP])


def test_a_snapshot_of_a_place_inside_furniture_is_refused(opened: World) -> None:
    assert isinstance(opened, OfficeWorld)
    opened.reset(np.random.default_rng(0))
    opened.pose[:2] = 0.9, 7.5  # the desk
    inside = opened.snapshot()
    opened.reset(np.random.default_rng(0))

    with pytest.raises(InvalidInput, match="Expected a snapshot of this world"):
        opened.restore(inside)


def test_a_plan_has_walls_around_its_rooms_and_none_in_its_doorways() -> None:
    x, y = TWO_ROOMS.size_m
    middles = np.array([(0.02, 0.7), (1.48, 1.25), (1.48, 0.75), (1.48, 0.25), (0.75, 0.02), (x - 0.02, y - 0.02)])

    assert (x, y) == (2.0, 1.5)
    assert (distance(TWO_ROOMS.walls, middles) == 0).tolist() == [True, True, False, True, True, True]
    assert distance(TWO_ROOMS.obstacles, np.array([(0.7, 0.4), (0.1, 0.4)])) == pytest.approx([0, 0])
    assert distance(TWO_ROOMS.obstacles, np.array([(1.0, 0.6)])) == pytest.approx([0.3])


def test_views_overlap_where_both_see_a_place() -> None:
    wall = np.array([(2.0, 0.0, 2.1, 10.0)])
    east, west, beyond = np.array([1.0, 5.0, 0.0]), np.array([1.0, 5.0, 180.0]), np.array([3.0, 5.0, 180.0])

    assert starts.overlap(wall, east, np.array([1.0, 6.0, 300.0]))
    assert not starts.overlap(wall, east, west)
    assert not starts.overlap(wall, east, beyond)
    assert starts.overlap(wall + 20, east, beyond)


def test_no_two_floors_share_a_texture() -> None:
    drawn = []
    for plan in FLOORS.values():
        names = {box.texture for box in plan.boxes()}
        textures = draw_textures(np.random.default_rng(plan.seed + 1), plan.rooms, names)
        drawn += [textures[name].pixels.tobytes() for name in names]

    assert len(set(drawn)) == len(drawn)


def test_landmarks_and_goals_are_judged_by_distance_and_heading() -> None:
    here, turned, aside = state(1, 1), state(1.2, 1.2, 40), state(1, 1.4, 335)
    references = [state(1, 1)] * 4

    assert judge("at-landmark", [here, turned, aside, state(1, 1, 50)], references) == [True, True, False, False]
    assert judge("at-landmark/goal", [here, turned, aside, state(1, 1, 50)], references) == [True, False, True, False]


def test_a_goal_is_reached_by_a_robot_that_did_not_begin_there() -> None:
    x, y, heading = FLOORS["office"].goals["goal-1"]
    there, turned = state(x, y - 0.4, heading + 25), state(x, y, heading + 90)

    assert judge("completed/goal-1", [turned, there, turned]) == [False, True, False]
    assert judge("completed/goal-1", [there, turned, there]) == [False, False, False]


def test_a_path_is_completed_by_its_places_in_order() -> None:
    places = FLOORS["office"].paths[LOOP]
    walked = [state(*place) for place in places]

    assert judge(f"completed/{LOOP}", walked) == [False] * (len(places) - 1) + [True]
    assert not any(judge(f"completed/{LOOP}", walked[:2] + walked[3:]))
    assert not any(judge(f"completed/{LOOP}", walked[1:]))
