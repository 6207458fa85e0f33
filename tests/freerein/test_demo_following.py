import numpy as np
import numpy.typing as npt

from freerein.cli.demo import following


def state(y: float, z: float, *blocks_y: float) -> npt.NDArray[np.float64]:
    """Returns the state with the gripper at (y, z) and blocks on the table at the given places."""
    return np.array([y, z, 0.03, *(number for at in blocks_y for number in (0, at, 0.025, 1, 0, 0, 0))])


def test_a_landmark_is_reached_when_gripper_and_every_block_are_within_half_a_block() -> None:
    landmark = state(0.1, 0.2, -0.1, 0.1)
    near, far_gripper, far_block = state(0.12, 0.18, -0.1, 0.12), state(0.13, 0.2, -0.1, 0.1), state(0.1, 0.2, -0.1, 0)
    assert following.is_at(np.stack([near, far_gripper, far_block]), landmark).tolist() == [True, False, False]


def test_landmarks_count_where_the_robot_was_while_it_pursued_them() -> None:
    there = np.stack([state(y, 0.2, 0.0) for y in (0.1, 0.2, 0.3, 0.4)])
    states = np.stack([state(y, 0.2, 0.0) for y in (0.0, 0.1, 0.2, 0.0, 0.3)])
    result = following.followed(states, np.array([0, 1, 1, 2, 2]), there)
    assert result.when_left.tolist() == [True, False, False, False]
    assert result.ever.tolist() == [True, True, True, False]


def test_a_last_landmark_counts_when_the_reply_says_that_all_is_done() -> None:
    there = np.stack([state(0.1, 0.2, 0.0)])
    result = following.followed(np.stack([state(0.1, 0.2, 0.0)] * 2), np.array([1, 1]), there)
    assert result.when_left.tolist() == result.ever.tolist() == [True]


def test_chance_goes_on_when_it_is_truly_there_or_the_time_is_up() -> None:
    there = np.stack([state(y, 0.2, 0.0) for y in (0.1, 0.2, 0.3)])
    states = np.stack([state(y, 0.2, 0.0) for y in (0.1, 0.0, 0.0, 0.3)])
    assert following.by_chance(states, there, max_steps=2).tolist() == [True, False, True]


def test_landmarks_are_evenly_spaced_later_frames() -> None:
    assert following.landmarks(20, count=5).tolist() == [6, 12, 18]
    assert following.landmarks(200, count=2).tolist() == [6, 12]
    assert following.landmarks(6, count=5).tolist() == []


def test_pairs_are_close_in_time_or_far_apart_and_as_many_of_each() -> None:
    lengths = np.array([50, 6, 40])
    drawn = following.pairs(lengths, np.random.default_rng(0), count=80, close_steps=2, far_steps=15)
    same = drawn.observations[:, 0] == drawn.goals[:, 0]
    apart = np.abs(drawn.observations[:, 1] - drawn.goals[:, 1])
    assert drawn.close.sum() == 40
    assert (same & (apart <= 2))[drawn.close].all()
    assert (~same | (apart > 15))[~drawn.close].all()
    assert 10 <= (same & ~drawn.close).sum() <= 20
    assert (drawn.observations[:, 1] < lengths[drawn.observations[:, 0]]).all()
