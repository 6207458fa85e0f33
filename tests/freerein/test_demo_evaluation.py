"""Success criteria on true states of `blocks`."""

import numpy as np
import numpy.typing as npt
import pytest

from freerein.cli.demo.evaluation import blocks, landmarks, recipes
from freerein.cli.demo.evaluation.landmarks import ReachedRates
from freerein.cli.demo.evaluation.recipes import SkillOutcome
from freerein.cli.demo.evaluation.relations import RELATIONS, BlockPair, true_relations, visible_pairs
from freerein.errors import InvalidInput

HIDDEN = (-0.9, 0.0, 0.025)
ON_TABLE, HELD, ON_TOP = 0.025, 0.12, 0.075
States = npt.NDArray[np.float64]


def state(*centres: tuple[float, float, float], gripper: tuple[float, float] = (0.1, 0.2)) -> States:
    """Returns the state with the gripper at (y, z) and blocks at (x, y, z)."""
    return np.array([*gripper, 0.03, *(number for centre in centres for number in (*centre, 1, 0, 0, 0))])


def beside(gripper_y: float, *blocks_y: float) -> States:
    """Returns the state with the gripper at y and blocks in a row on the table."""
    return state(*((0, y, ON_TABLE) for y in blocks_y), gripper=(gripper_y, 0.2))


def episode(*changes: dict[str, tuple[float, float]]) -> States:
    """Returns states in which blocks stay in a row until they move to (y, z), by colour."""
    places = {colour: (0.1 * place, ON_TABLE) for place, colour in enumerate(blocks.COLOURS)}
    found = []
    for change in changes:
        places = {**places, **change}
        found.append(state(*((0, y, z) for y, z in places.values())))
    return np.stack(found)


def test_a_state_holds_the_gripper_and_the_blocks() -> None:
    states = state((0, 0.1, 0.025), (0, 0.2, 0.025), (0, 0.3, 0.025), HIDDEN)[None]
    assert blocks.gripper_positions(states).tolist() == [[0.1, 0.2]]
    assert blocks.block_positions(states)[0, :, 1].tolist() == [0.1, 0.2, 0.3, 0.0]
    assert blocks.block_positions(states).shape == (1, len(blocks.COLOURS), 3)


def test_relations_are_those_of_visible_blocks() -> None:
    side_by_side = state((0, 0.1, 0.025), (0, 0.16, 0.025), HIDDEN, HIDDEN)
    stacked = state((0, 0.1, 0.075), (0, 0.1, 0.025), HIDDEN, HIDDEN)
    states = np.stack([side_by_side, stacked, state(HIDDEN, (0, 0.1, 0.025), HIDDEN, HIDDEN)])
    red_green = BlockPair("red", "green")
    assert {pair: indices.tolist() for pair, indices in visible_pairs(states).items()} == {
        red_green: [0, 1],
        BlockPair("green", "red"): [0, 1],
    }
    assert [RELATIONS[index] for index in true_relations(states[:2], red_green)] == ["to the left of", "on top of"]


def test_a_landmark_is_reached_when_gripper_and_every_block_are_within_half_a_block() -> None:
    landmark = beside(0.1, -0.1, 0.1)
    near, far_gripper, far_block = beside(0.12, -0.1, 0.12), beside(0.13, -0.1, 0.1), beside(0.1, -0.1, 0)
    states = np.stack([near, far_gripper, far_block])
    assert landmarks.is_at(states, landmark).tolist() == [True, False, False]
    assert landmarks.needs_block_move(states, landmark).tolist() == [False, False, True]


def test_landmarks_count_where_the_robot_was_while_it_pursued_them() -> None:
    targets = np.stack([beside(y, 0.0) for y in (0.1, 0.2, 0.3, 0.4)])
    states = np.stack([beside(y, 0.0) for y in (0.0, 0.1, 0.2, 0.0, 0.3)])
    pursuit = landmarks.pursue(states, np.array([0, 1, 1, 2, 2]), targets)
    assert pursuit.landmark.tolist() == [0, 0, 1, 1, 2]
    assert pursuit.recognized.tolist() == [True, False, False, False]
    assert pursuit.reached.tolist() == [True, True, True, False]


def test_a_last_landmark_counts_when_the_reply_says_that_all_is_done() -> None:
    targets = beside(0.1, 0.0)[None]
    pursuit = landmarks.pursue(np.stack([beside(0.1, 0.0)] * 2), np.array([1, 1]), targets)
    assert pursuit.recognized.tolist() == pursuit.reached.tolist() == [True]
    assert pursuit.is_active.tolist() == [True, False]
    with pytest.raises(InvalidInput, match="one reply per state"):
        landmarks.pursue(targets, np.array([0, 0]), targets)


def test_random_actions_go_on_when_truly_there_or_the_time_is_up() -> None:
    targets = np.stack([beside(y, 0.0) for y in (0.1, 0.2, 0.3)])
    states = np.stack([beside(y, 0.0) for y in (0.1, 0.0, 0.0, 0.3)])
    assert landmarks.reached_at_random(states, targets, max_steps=2).tolist() == [True, False, True]


def test_rates_are_split_by_whether_a_block_must_move() -> None:
    reached, moves = np.array([True, True, False, True, False]), np.array([False, False, False, True, True])
    assert landmarks.reached_rates(reached, moves) == ReachedRates(0.6, 0.5, 2 / 3)
    with pytest.raises(InvalidInput):
        landmarks.reached_rates(reached, np.zeros(5, bool))


@pytest.mark.parametrize(("length", "count", "steps"), [(20, 5, [6, 12, 18]), (200, 2, [6, 12]), (6, 5, [])])
def test_landmarks_are_evenly_spaced_later_frames(length: int, count: int, steps: list[int]) -> None:
    assert landmarks.landmark_steps(length, count=count).tolist() == steps


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
def test_a_skill_is_completed_when_its_block_was_lifted_and_rests_elsewhere(
    changes: list[dict[str, tuple[float, float]]], lifted: bool, completed: bool
) -> None:
    assert recipes.outcome("move-red", episode(*changes)) == SkillOutcome(lifted, completed)


def test_each_attempt_ends_in_the_state_in_which_the_next_begins() -> None:
    states = episode(*[{"red": (0.01 * t, ON_TABLE)} for t in range(6)])
    found = recipes.attempts(["move-red", "move-blue", "move-green"], states, np.array([0, 0, 0, 1, 1, 1]))
    assert [skill for skill, _ in found] == ["move-red", "move-blue"]
    np.testing.assert_array_equal(found[0][1], states[:4])
    np.testing.assert_array_equal(found[1][1], states[3:])
