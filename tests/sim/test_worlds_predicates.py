"""Predicates of the blocks and grid tasks on states made by hand."""

from itertools import groupby, permutations

import numpy as np
import numpy.typing as npt
import pytest

from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.blocks.spec import COLOURS
from freerein_sim.worlds.predicates import StatePredicate

HIDDEN = (-0.9, 0.0, 0.025)
ON_TABLE, HELD, ON_TOP = 0.025, 0.12, 0.075
TASKS = {task.name: task for task in (*blocks.TASKS, *grid.TASKS)}
PREDICATES = {task.name: {each.name: each for each in task.predicates} for task in TASKS.values()}
BLOCKS, PAIR, GRID = PREDICATES["blocks"], PREDICATES["blocks.red-left-of-green"], PREDICATES["grid"]
States = npt.NDArray[np.float64]


def state(*centres: tuple[float, float, float], gripper: tuple[float, float] = (0.1, 0.2)) -> States:
    """Returns the state with the gripper at (y, z) and blocks at (x, y, z); blocks that are left out are hidden."""
    centres += (HIDDEN,) * (len(COLOURS) - len(centres))
    return np.array([*gripper, 0.03, *(number for centre in centres for number in (*centre, 1, 0, 0, 0))])


def beside(gripper_y: float, *blocks_y: float) -> States:
    """Returns the state with the gripper at y and blocks in a row on the table."""
    return state(*((0, y, ON_TABLE) for y in blocks_y), gripper=(gripper_y, 0.2))


def episode(*changes: dict[str, tuple[float, float]]) -> States:
    """Returns states in which blocks stay in a row until they move to (y, z), by colour."""
    places = {colour: (0.1 * place, ON_TABLE) for place, colour in enumerate(COLOURS)}
    found = []
    for change in changes:
        places = {**places, **change}
        found.append(state(*((0, y, z) for y, z in places.values())))
    return np.stack(found)


def judge(predicate: StatePredicate, states: States, *references: States) -> list[bool]:
    """Returns where a predicate holds in one sequence."""
    return predicate.holds(states[None], *(each[None] for each in references))[0].tolist()


def test_a_task_names_its_predicates() -> None:
    goal = ["at-landmark", "object-moves", "lifted/move-red", "completed/move-red"]
    skills = [f"{what}/move-{colour}" for what in ("lifted", "completed") for colour in COLOURS]
    assert list(PAIR) == [*goal, "start/in-order"]
    assert list(PREDICATES["blocks.red-on-top-of-green"])[-1] == "start/from-left"
    assert [name for name in BLOCKS if not name.startswith("relation/")] == [*goal[:2], *skills]
    assert list(GRID) == ["at-landmark", "object-moves", *(f"completed/{skill}" for skill in grid.SPEC.skills)]
    described = {each.name: each for each in TASKS["blocks"].describe().predicates}
    assert described["at-landmark"].needs_reference
    assert described["relation/red-on-top-of-blue"].text == "a red block on top of a blue block"
    assert described["relation/red-on-top-of-blue"].group == "relation/red-blue"


def test_each_ordered_pair_of_blocks_has_a_group_of_five_captions() -> None:
    relations = [each for each in PREDICATES["blocks.scatter"].values() if each.group]
    groups = {group: [each.text for each in members] for group, members in groupby(relations, lambda each: each.group)}
    assert list(groups) == [f"relation/{first}-{second}" for first, second in permutations(COLOURS, 2)]
    assert groups["relation/blue-green"] == [
        f"a blue block {words} a green block"
        for words in ("to the left of", "to the right of", "on top of", "below", "apart from")
    ]


@pytest.mark.parametrize(
    ("red", "green", "expected"),
    [
        ((0, 0.1, ON_TABLE), (0, 0.16, ON_TABLE), "left-of"),
        ((0, 0.16, ON_TABLE), (0, 0.1, ON_TABLE), "right-of"),
        ((0, 0.1, ON_TOP), (0, 0.1, ON_TABLE), "on-top-of"),
        ((0, 0.1, ON_TABLE), (0, 0.1, ON_TOP), "below"),
        ((0, 0.1, ON_TABLE), (0, 0.3, ON_TABLE), "apart-from"),
        (HIDDEN, (0, 0.1, ON_TABLE), None),
        ((0, 0.1, ON_TABLE), HIDDEN, None),
    ],
)
def test_exactly_one_relation_of_a_pair_holds_where_both_blocks_are_visible(
    red: tuple[float, float, float], green: tuple[float, float, float], expected: str | None
) -> None:
    states = state(red, green, HIDDEN, HIDDEN)[None]
    holding = [name for name, each in BLOCKS.items() if each.group == "relation/red-green" and judge(each, states)[0]]
    assert holding == ([] if expected is None else [f"relation/red-{expected}-green"])


def test_a_landmark_is_reached_when_gripper_and_every_block_are_within_half_a_block() -> None:
    near, far_gripper, far_block = beside(0.12, -0.1, 0.12), beside(0.13, -0.1, 0.1), beside(0.1, -0.1, 0)
    states, landmarks = np.stack([near, far_gripper, far_block]), np.stack([beside(0.1, -0.1, 0.1)] * 3)
    assert judge(PAIR["at-landmark"], states, landmarks) == [True, False, False]
    assert judge(PAIR["object-moves"], states, landmarks) == [False, False, True]


@pytest.mark.parametrize(
    ("changes", "lifted", "completed"),
    [
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, ON_TABLE)}], True, True),
        ([{}, {"red": (0.0, HELD)}, {"red": (0.21, ON_TOP)}], True, True),
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, HELD)}], True, False),
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, ON_TOP)}], True, False),
        ([{}, {"red": (0.0, HELD)}, {"red": (0.02, ON_TABLE)}], True, False),
        ([{}, {"red": (0.0, HELD)}, {"red": (-0.05, ON_TABLE), "blue": (0.33, ON_TABLE)}], True, False),
        ([{}, {"red": (-0.05, ON_TABLE)}], False, False),
        ([{}], False, False),
    ],
    ids=["put down", "stacked", "held", "in the air", "put back", "another pushed", "pushed", "nothing"],
)
def test_a_block_is_moved_when_it_was_lifted_and_rests_elsewhere(
    changes: list[dict[str, tuple[float, float]]], lifted: bool, completed: bool
) -> None:
    states = episode(*changes)
    assert judge(BLOCKS["lifted/move-red"], states)[-1] == lifted
    assert judge(BLOCKS["completed/move-red"], states)[-1] == completed


def test_a_skill_is_judged_at_each_timestep_given_those_before_it() -> None:
    moving = episode({}, {"red": (0.0, HELD)}, {"red": (-0.05, ON_TABLE)}, {"red": (0.0, ON_TABLE)})
    assert judge(BLOCKS["lifted/move-red"], moving) == [False, True, True, True]
    assert judge(BLOCKS["completed/move-red"], moving) == [False, False, True, False]


@pytest.mark.parametrize(
    ("task", "left"),
    [
        ("blocks.red-left-of-green", True),
        ("blocks.red-right-of-green", False),
        ("blocks.red-on-top-of-green", True),
    ],
)
def test_a_start_is_told_by_the_side_on_which_the_first_block_began(task: str, left: bool) -> None:
    (starts,) = (each for name, each in PREDICATES[task].items() if name.startswith("start/"))
    one, other = beside(0, -0.1, 0.1), beside(0, 0.1, -0.1)
    assert judge(starts, np.stack([one, other])) == [left, left]
    assert judge(starts, np.stack([other, one])) == [not left, not left]


def test_sequences_are_judged_apart() -> None:
    lifted, still = episode({}, {"red": (0.0, HELD)}), episode({}, {})
    assert BLOCKS["lifted/move-red"].holds(np.stack([lifted, still])).tolist() == [[False, True], [False, False]]


def test_an_object_of_the_grid_is_picked_up_when_it_lay_there_at_first() -> None:
    lying = np.array([4.0, 4.0, 1.0, 1.0, *range(8)])
    without_red, walked = lying.copy(), lying.copy()
    without_red[2:4], walked[0] = -1, 5
    assert judge(GRID["completed/pick-red"], np.stack([lying, walked, without_red])) == [False, False, True]
    assert judge(GRID["completed/pick-red"], np.stack([without_red, without_red])) == [False, False]
    assert judge(GRID["completed/pick-green"], np.stack([lying, without_red])) == [False, False]
    landmarks = np.stack([lying] * 3)
    assert judge(GRID["at-landmark"], np.stack([lying, walked, without_red]), landmarks) == [True, False, False]
    assert judge(GRID["object-moves"], np.stack([lying, walked, without_red]), landmarks) == [False, False, True]
