"""The tasks of table 4.2: a relation of two of three colours to train on, and of the fourth and one of these for tests.

Nothing blue is for training (section 4.3).
"""

from collections.abc import Mapping
from types import MappingProxyType

from experiments.teachers import COLOURS, RELATIONS, STARTS, TASKS

TEST_COLOUR = "blue"
TEST_TASKS = tuple(
    f"blocks.{first}-{relation}-{second}"
    for relation in RELATIONS
    for colour in COLOURS
    for first, second in ((TEST_COLOUR, colour), (colour, TEST_COLOUR))
)

TRAIN, TEST = "train", "test"
TASK_SETS: Mapping[str, tuple[str, ...]] = MappingProxyType({TRAIN: TASKS, TEST: TEST_TASKS})

PARTS = tuple(f"{tasks}.{starts}" for tasks in TASK_SETS for starts in STARTS)
"""Cells of table 4.2: which tasks, and how far apart blocks begin."""
