import numpy as np

from freerein.cli.demo import blocks, relations
from freerein.cli.demo.relations import RELATIONS, Pair

PARKED = (-0.9, 0.0, 0.025)


def state(*centres: tuple[float, float, float]) -> blocks.States:
    """Returns the state with the gripper at (0.1, 0.2) and the four blocks at the given places."""
    return np.array([0.1, 0.2, 0.03, *(number for centre in centres for number in (*centre, 1, 0, 0, 0))])


def test_a_state_tells_where_gripper_and_blocks_are() -> None:
    states = state((0, 0.1, 0.025), (0, 0.2, 0.025), (0, 0.3, 0.025), PARKED)[None]
    assert blocks.grippers(states).tolist() == [[0.1, 0.2]]
    assert blocks.places(states)[0, :, 1].tolist() == [0.1, 0.2, 0.3, 0.0]
    assert blocks.places(states).shape == (1, len(blocks.COLOURS), 3)


def test_relations_are_told_of_the_blocks_that_are_on_show() -> None:
    beside = state((0, 0.1, 0.025), (0, 0.16, 0.025), PARKED, PARKED)
    stacked = state((0, 0.1, 0.075), (0, 0.1, 0.025), PARKED, PARKED)
    states = np.stack([beside, stacked, state(PARKED, (0, 0.1, 0.025), PARKED, PARKED)])
    red_green = Pair("red", "green")
    assert {pair: which.tolist() for pair, which in relations.questions(states).items()} == {
        red_green: [0, 1],
        Pair("green", "red"): [0, 1],
    }
    told = [RELATIONS[index] for index in relations.truth(states[:2], red_green)]
    assert told == ["to the left of", "on top of"]
