"""Initial states of blocks and gripper: one sampler for each kind of task, a pure function of a generator."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.blocks import scene
from freerein_sim.worlds.blocks.goals import BlockGoal
from freerein_sim.worlds.blocks.relations import BLOCK_M, CLOSE_M, PLACED_ASIDE_M, BlockRelation, Position
from freerein_sim.worlds.blocks.spec import COLOURS
from freerein_sim.worlds.blocks.variation import Begin

PARKED_M = np.array([(scene.PAD_M[0], (i - 1.5) * 2 * BLOCK_M, BLOCK_M / 2) for i in range(len(COLOURS))])
"""Position of each hidden block on the pad, in the order of `COLOURS`: float64 (4, 3)."""

_PLACES, _PITCH_M = 6, 0.08
"""Number of places on the line and their spacing, which leaves room for a block and an open gripper."""

_LINE_JITTER_M, _PLACE_JITTER_M = 0.01, 0.0015

_PAIR_M = (-0.07, 0.07)
SEEN_M, UNSEEN_M = BLOCK_M, 2 * BLOCK_M
"""Interval, one and two blocks wide, in which each block of a pair begins (dissertation: seen and unseen starts)."""

_BYSTANDERS_M = np.linspace(-0.21, 0.21, 421)
_GRIPPER_ROOM_M, _BLOCK_ROOM_M = 0.077, 0.06
"""Distances from a bystander: of a block where the gripper will open, and of any other."""

_ABOVE_Y_M, _ABOVE_Z_M = (-0.2, 0.2), (0.13, 0.22)

_LOW_M, _HIGH_M = np.array([-0.2, BLOCK_M / 2]), np.array([0.2, 0.19])
"""Range of scattered blocks, y and z: visible to the front camera, and within reach of the gripper."""

_NEAR_M = 2.5 * BLOCK_M
_ODDS = (1 / 2, 1 / 6, 1 / 6, 1 / 6)
"""Probabilities of two scattered blocks being anywhere, near one another, stacked, and side by side."""

_GRASP_PROBABILITY = 0.3
"""Probability of trying a grasp. About one in six has no room, so a block is held in a quarter of the states."""

_GRASP_ABOVE_M = (0.0, 0.03)
_NEARNESS = 2.5
"""Exponent of a uniform number: the share of the way from a block to the gripper's own place. Half of the starts are
nearer than a sixth of it."""

_PALM_HALF_Y_M, _PALM_ABOVE_M = 0.063, 0.032
"""Half width of the palm, and its height above the midpoint of the fingers."""

_ROUNDING_M = 1e-9

Point = npt.NDArray[np.float64]
"""float64 (2,): y and z in metres; (N, 2) for N points."""


@dataclass(frozen=True, eq=False)
class GripperState:
    """Pose and finger opening of the gripper.

    Attributes:
        at: Midpoint between the fingers.
        finger_m: Distance of each finger from the midpoint.
        target_m: Target of that distance; smaller than `finger_m` when the fingers press on a block.
    """

    at: Point
    finger_m: float
    target_m: float


@dataclass(frozen=True, eq=False)
class InitialState:
    """State before the first action; `blocks` are the centres in metres, float64 (N, 3)."""

    blocks: Position
    gripper: GripperState


InitialStateSampler = Callable[[np.random.Generator, Sequence[str]], InitialState]
"""Draws an initial state in which the blocks of some colours, at least, are on show."""


def line(rng: np.random.Generator, wanted: Sequence[str] = (), *, count: int = len(COLOURS)) -> InitialState:
    """Returns a number of blocks on the table, far enough apart for the gripper above them; the others are parked."""
    places = (np.arange(_PLACES) - (_PLACES - 1) / 2) * _PITCH_M + rng.uniform(-_LINE_JITTER_M, _LINE_JITTER_M)
    ys = rng.choice(places, size=len(COLOURS), replace=False)
    ys += rng.uniform(-_PLACE_JITTER_M, _PLACE_JITTER_M, size=ys.shape)
    start = _on_table(rng, ys)
    if count < len(COLOURS):
        others = [i for i, colour in enumerate(COLOURS) if colour not in wanted]
        hidden = rng.permutation(others)[: len(COLOURS) - count]
        start.blocks[hidden] = PARKED_M[hidden]
    return start


def pair(
    rng: np.random.Generator,
    wanted: Sequence[str] = (),
    *,
    goal: BlockGoal,
    count: int = 2,
    interval_m: float = SEEN_M,
    begins: Sequence[Begin] = (),
) -> InitialState:
    """Returns a goal's two blocks on the table, apart, in either order, and bystanders of drawn colours.

    Each of the two lies within an interval of that width. Bystanders stand where the expert needs no room. The blocks
    of a goal are always on show, whatever is wanted. One of `begins` is drawn, for a curriculum of starts.
    """
    goal_blocks = [COLOURS.index(goal.first), COLOURS.index(goal.second)]
    while True:
        ys = rng.permutation(_PAIR_M) + rng.uniform(-interval_m / 2, interval_m / 2, size=2)
        if abs(ys[0] - ys[1]) < CLOSE_M:
            continue
        start = _on_table(rng, ys)
        blocks = PARKED_M.copy()
        blocks[goal_blocks] = start.blocks
        if count > 2:
            bystanders = _bystanders(rng, goal.relation, ys, count=count - 2)
            if bystanders is None:
                continue
            others = [i for i in range(len(COLOURS)) if i not in goal_blocks]
            shown = rng.permutation(others)[: count - 2]
            blocks[shown] = np.stack([(0, y, BLOCK_M / 2) for y in bystanders])
        drawn = InitialState(blocks, start.gripper)
        return _begun(rng, drawn, goal_blocks[0], begins[int(rng.integers(len(begins)))]) if begins else drawn


def _begun(rng: np.random.Generator, own: InitialState, first: int, begin: Begin) -> InitialState:
    """Returns how an episode begins, given the task's own state and the number of the block that its goal moves."""
    blocks = own.blocks.copy()
    others = np.delete(blocks, first, axis=0)
    others = others[others[:, 0] == 0, 1:]  # not the hidden ones
    match begin:
        case "own":
            return own
        case "near":
            return InitialState(blocks, _approaching(rng, blocks[first, 1:], others, own.gripper))
    while True:
        block = rng.uniform(_LOW_M, _HIGH_M)
        gripper = _grasp(rng, block[None])
        if gripper is not None and _is_clear(gripper, others) and (np.abs(others - block).max(axis=1) > BLOCK_M).all():
            blocks[first, 1:] = block
            return InitialState(blocks, gripper)


def scatter(
    rng: np.random.Generator, wanted: Sequence[str] = (), *, fewest: int = 2, most: int = len(COLOURS)
) -> InitialState:
    """Returns some blocks anywhere in the plane, one possibly in the gripper; the others are parked.

    Two of them are arranged; there are no skills, so that none is wanted.
    """
    count = int(rng.integers(fewest, most, endpoint=True))
    arrange = (_anywhere, _near, _stacked, _beside)[rng.choice(len(_ODDS), p=_ODDS)]
    shown = arrange(rng, rng.uniform(_LOW_M, _HIGH_M))
    while len(shown) < count:
        another = rng.uniform(_LOW_M, _HIGH_M)
        if (np.abs(shown - another).max(axis=1) > BLOCK_M).all():
            shown = np.vstack([shown, another])
    blocks = PARKED_M.copy()
    blocks[rng.choice(len(COLOURS), size=count, replace=False)] = np.insert(shown, 0, 0.0, axis=1)
    holding = _grasp(rng, shown) if rng.random() < _GRASP_PROBABILITY else None
    return InitialState(blocks, holding or _free_gripper(rng, shown))


def _bystanders(
    rng: np.random.Generator, relation: BlockRelation, ys: npt.NDArray[np.float64], *, count: int
) -> npt.NDArray[np.float64] | None:
    """Draws where one or two more blocks stand, y; None where there is no room for them.

    Args:
        rng: The generator.
        relation: The goal's.
        ys: float64 (2,), y of its blocks.
        count: Number of bystanders.
    """
    first, second = ys
    if relation is BlockRelation.ON_TOP_OF:
        grasps, others = np.array([first, second]), np.array([second])
    else:
        side = -1 if relation is BlockRelation.LEFT_OF else 1
        grasps, others = np.array([first, second + side * PLACED_ASIDE_M]), np.array([second])
    free = _BYSTANDERS_M[
        (np.abs(_BYSTANDERS_M[:, None] - grasps) > _GRIPPER_ROOM_M).all(axis=1)
        & (np.abs(_BYSTANDERS_M[:, None] - others) > _BLOCK_ROOM_M).all(axis=1)
    ]
    if count == 1:
        return rng.choice(free, size=1) if len(free) else None
    choices = np.argwhere(np.abs(free[:, None] - free) > _BLOCK_ROOM_M)
    return free[choices[rng.integers(len(choices))]] if len(choices) else None


def _on_table(rng: np.random.Generator, ys: npt.NDArray[np.float64]) -> InitialState:
    blocks = np.stack([np.zeros_like(ys), ys, np.full_like(ys, BLOCK_M / 2)], axis=1)
    finger_m = rng.uniform(*scene.FINGER_M)
    at = np.array([rng.uniform(*_ABOVE_Y_M), rng.uniform(*_ABOVE_Z_M)])
    return InitialState(blocks, GripperState(at, finger_m, finger_m))


def _anywhere(rng: np.random.Generator, first: Point) -> Point:
    while True:
        second = rng.uniform(_LOW_M, _HIGH_M)
        if np.abs(second - first).max() > BLOCK_M:
            return np.stack([first, second])


def _near(rng: np.random.Generator, first: Point) -> Point:
    while True:
        blocks = _anywhere(rng, first)
        if np.linalg.norm(blocks[1] - first) < _NEAR_M:
            return blocks


def _stacked(rng: np.random.Generator, first: Point) -> Point:
    """Returns a block on the table and one that rests on it."""
    y, z = first[0], _LOW_M[1]
    upper_y = np.clip(y + rng.uniform(-BLOCK_M / 2, BLOCK_M / 2), _LOW_M[0], _HIGH_M[0])
    return np.array([(y, z), (upper_y, z + BLOCK_M)])


def _beside(rng: np.random.Generator, first: Point) -> Point:
    """Returns a block on the table and one beside it, towards the middle."""
    y, z = first[0], _LOW_M[1]
    return np.array([(y, z), (y - np.sign(y) * rng.uniform(BLOCK_M, _NEAR_M), z)])


def _free_gripper(rng: np.random.Generator, blocks: Point) -> GripperState:
    """Draws a gripper state that collides with no block."""
    limits = np.transpose([scene.GRIPPER_Y_M, scene.GRIPPER_Z_M])
    while True:
        finger_m = rng.uniform(*scene.FINGER_M)
        gripper = GripperState(rng.uniform(*limits), finger_m, finger_m)
        if _is_clear(gripper, blocks):
            return gripper


def _approaching(rng: np.random.Generator, block: Point, others: Point, own: GripperState) -> GripperState:
    """Draws a gripper on the way from a block, around which it is open or closing, to its own place."""
    while True:
        grasp = np.add(block, (0.0, rng.uniform(*_GRASP_ABOVE_M)))
        way = rng.random() ** _NEARNESS
        at = grasp + way * (own.at - grasp)
        finger_m = rng.uniform(*scene.FINGER_M)
        gripper = GripperState(at, finger_m, rng.uniform(way, 1) * finger_m)
        if at[1] > scene.GRIPPER_Z_M[0] and _is_clear(gripper, np.vstack([block, others])):
            return gripper


def _grasp(rng: np.random.Generator, blocks: Point) -> GripperState | None:
    """Draws a gripper closed on one of the blocks; None if it would collide with the other or the table."""
    for block in rng.permutation(blocks):
        at = np.add(block, (0.0, rng.uniform(*_GRASP_ABOVE_M)))
        gripper = GripperState(at, BLOCK_M / 2 - scene.FINGER_BASE_M, scene.FINGER_M[0])
        if at[1] > scene.GRIPPER_Z_M[0] and _is_clear(gripper, blocks):
            return gripper
    return None


def _is_clear(gripper: GripperState, blocks: Point) -> bool:
    """Returns whether neither the fingers nor the palm intersect a block."""
    aside, above = np.abs(blocks[:, 0] - gripper.at[0]), blocks[:, 1] - gripper.at[1]
    inner_m = scene.FINGER_BASE_M + gripper.finger_m
    outer_m = inner_m + 2 * scene.FINGER_HALF_M[1]
    between = aside < inner_m - BLOCK_M / 2 + _ROUNDING_M
    beyond = (aside > outer_m + BLOCK_M / 2) | (np.abs(above) > scene.FINGER_HALF_M[0] + BLOCK_M / 2)
    off_palm = (aside > _PALM_HALF_Y_M + BLOCK_M / 2) | (above < _PALM_ABOVE_M - BLOCK_M / 2)
    return bool(((between | beyond) & off_palm).all())
