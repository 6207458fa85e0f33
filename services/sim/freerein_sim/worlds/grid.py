"""The dissertation's grid world: walk to coloured objects and pick them up in a given order.

The field has 10 x 10 cells. The leftmost cell of one more row below it, the indicator, shows the colour of the next
object to pick up. A cell is 3 x 3 pixels, an image 33 x 30. All five objects lie on the field in every episode, so that
the scene does not reveal which skills occur.
"""

import hashlib
import struct
from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.predicates import AT_LANDMARK, OBJECT_MOVES, Flags, StatePredicate, States
from freerein_sim.worlds.world import (
    Action,
    Frame,
    GroundTruth,
    LabelledAction,
    StepResult,
    TaskDefinition,
    WorldSpec,
    check_actions,
    check_view,
    foreign_snapshot,
    skill_indices,
)

VERSION = 1
"""Version of the world; raised where it behaves differently."""

FIELD = 10
CELL_PX = 3
COLOURS = ("red", "green", "blue", "yellow", "purple")
PICK_UP = 4

_HEIGHT, _WIDTH = (FIELD + 1) * CELL_PX, FIELD * CELL_PX
_MAX_STEPS = 50
_MOVES = np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
_RGB = np.array([[230, 40, 40], [40, 200, 60], [50, 90, 240], [245, 210, 40], [180, 60, 220]], np.uint8)
_GROUND, _FRAME, _AGENT = (28, 30, 36), (60, 64, 74), (245, 245, 245)
_NOWHERE = -1
_FORMAT_VERSION = 1
_LAYOUT = struct.Struct("<B2b10b5b5b")

SPEC = WorldSpec(
    cameras=(Camera("top", _HEIGHT, _WIDTH, 3),),
    action=ActionSpec(size=1, choices=5, names=("up", "down", "left", "right", "pick-up")),
    control_dt_s=0.1,
    skills=tuple(f"pick-{colour}" for colour in COLOURS),
    max_episode_steps=_MAX_STEPS,
    state_names=(
        "agent.row",
        "agent.column",
        *(f"{colour}.{axis}" for colour in COLOURS for axis in ("row", "column")),
    ),
    max_size=_HEIGHT,
)


class GridWorld:
    """The grid world.

    An episode has a recipe, the objects to pick up in order. `pick-up` takes any object under the agent. The indicator
    shows the first object of the recipe that still lies on the field; the episode terminates when none does, and is a
    success if exactly the recipe was picked up, in order.
    """

    spec = SPEC
    steps = None

    def __init__(self, *, indicator: bool) -> None:
        self._indicator = indicator
        self._agent = np.zeros(2, np.int64)  # row, column
        self._objects = np.full((len(COLOURS), 2), _NOWHERE, np.int64)  # by colour: row, column
        self._recipe: tuple[int, ...] = ()
        self._picked: tuple[int, ...] = ()

    @property
    def fingerprint(self) -> str:
        """Hash of the format version, the spec and the indicator."""
        return hashlib.sha256(f"grid {_FORMAT_VERSION} {self._indicator} {SPEC}".encode()).hexdigest()

    @property
    def target(self) -> int | None:
        """Index of the next object to pick up, None when the recipe is done."""
        return next((i for i in self._recipe if i not in self._picked), None)

    @property
    def picked(self) -> tuple[int, ...]:
        """Indices of the objects picked up so far, in order."""
        return self._picked

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Places agent and objects so that an expert can finish in time; an empty recipe means all, shuffled."""
        wanted = skill_indices(SPEC, recipe)
        if len(set(wanted)) != len(wanted):
            raise InvalidInput(
                "A recipe of this world names each skill once; got one twice.",
                field="skills",
                hint="Leave the recipe out for all skills in any order.",
            )
        self._recipe = wanted or tuple(int(i) for i in rng.permutation(len(COLOURS)))
        self._picked = ()
        while True:
            cells = rng.choice(FIELD * FIELD, size=len(COLOURS) + 1, replace=False)
            places = np.stack(np.divmod(cells, FIELD), axis=1)
            self._agent, self._objects = places[0], places[1:]
            if _expert_steps(places[0], places[1:], self._recipe) <= _MAX_STEPS:
                return

    def step(self, action: Action) -> StepResult:
        """Moves one cell within the field, or picks up the object under the agent."""
        check_actions(SPEC.action, action)
        choice = int(action[0])
        if choice == PICK_UP:
            here = np.flatnonzero((self._objects == self._agent).all(axis=1))
            self._objects[here] = _NOWHERE
            self._picked += tuple(int(i) for i in here)
        else:
            self._agent = np.clip(self._agent + _MOVES[choice], 0, FIELD - 1)
        return StepResult(terminated=self.target is None)

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the image, in the world's only size."""
        check_view(SPEC, camera, height=height, width=width)
        if (height, width) != (_HEIGHT, _WIDTH):
            raise InvalidInput(
                f"Frames of this world are {_HEIGHT} x {_WIDTH} pixels; got {height} x {width}.", field="height"
            )
        image = np.empty((_HEIGHT, _WIDTH, 3), np.uint8)
        image[:], image[FIELD * CELL_PX :] = _GROUND, _FRAME
        for (row, column), rgb in zip(self._objects, _RGB, strict=True):
            if row != _NOWHERE:
                _cell(image, row, column)[:] = rgb
        agent = _cell(image, *self._agent)
        beneath = agent[1, 1].copy()
        agent[:], agent[1, 1] = _AGENT, beneath
        if self._indicator:
            _cell(image, FIELD, 0)[:] = 0 if self.target is None else _RGB[self.target]
        return image

    def snapshot(self) -> bytes:
        """Returns the state in 24 bytes."""
        recipe, picked = (row + (_NOWHERE,) * (len(COLOURS) - len(row)) for row in (self._recipe, self._picked))
        return _LAYOUT.pack(_FORMAT_VERSION, *self._agent, *self._objects.ravel(), *recipe, *picked)

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot, after checking every number."""
        if len(snapshot) != _LAYOUT.size or snapshot[0] != _FORMAT_VERSION:
            raise foreign_snapshot(f"a snapshot of {_LAYOUT.size} bytes and version {_FORMAT_VERSION}")
        numbers = np.array(_LAYOUT.unpack(snapshot)[1:], np.int64)
        agent, objects = numbers[:2], numbers[2:12].reshape(-1, 2)
        recipe, picked = (tuple(int(i) for i in part if i != _NOWHERE) for part in (numbers[12:17], numbers[17:]))
        _check_state(agent, objects, recipe, picked)
        self._agent, self._objects, self._recipe, self._picked = agent, objects, recipe, picked

    def truth(self) -> GroundTruth:
        """Returns all positions (-1 for objects picked up); the reward is 1.0 when the recipe was followed exactly."""
        success = bool(self._recipe) and self._picked == self._recipe
        return GroundTruth(
            np.concatenate([self._agent, self._objects.ravel()]).astype(np.float64), float(success), success
        )

    def expert(self, skills: Sequence[str], rng: np.random.Generator) -> "GridExpert":
        """Returns an expert that walks to each object by a shortest path and picks it up."""
        return GridExpert(self, skill_indices(SPEC, skills) or self._recipe, rng)

    def close(self) -> None:
        """Does nothing."""


class GridExpert:
    """Walks shortest paths; draws an axis where both shorten the distance."""

    def __init__(self, world: GridWorld, skills: tuple[int, ...], rng: np.random.Generator) -> None:
        self._world = world
        self._skills = skills
        self._rng = rng

    def act(self) -> LabelledAction | None:
        """Returns the next step towards the first remaining object."""
        state = self._world.truth().state.astype(np.int64)
        objects = state[2:].reshape(-1, 2)
        wanted = next((i for i in self._skills if objects[i, 0] != _NOWHERE), None)
        if wanted is None:
            return None
        way = objects[wanted] - state[:2]  # rows down, columns right
        distance = np.abs(way)
        if not distance.any():
            return LabelledAction(np.array([PICK_UP]), wanted)
        axis = int(self._rng.random() * distance.sum() >= distance[0])
        return LabelledAction(np.array([2 * axis + int(way[axis] > 0)]), wanted)

    def succeeded(self) -> bool:
        """Returns whether exactly its objects were picked up, in order."""
        return self._world.picked == self._skills


def _is_at(states: States, references: States) -> Flags:
    return np.asarray((states == references).all(axis=-1))


def _object_moves(states: States, references: States) -> Flags:
    first = SPEC.state_names.index("red.row")
    return ~_is_at(states[..., first:], references[..., first:])


def _is_picked(colour: str, states: States) -> Flags:
    """The object lay on the field in the first state, and does not any more."""
    row = states[..., SPEC.state_names.index(f"{colour}.row")]  # (N, T)
    return np.asarray((row[:, :1] != _NOWHERE) & (row == _NOWHERE))


def _cell(image: Frame, row: int, column: int) -> Frame:
    """Returns a view of one cell's pixels."""
    return image[row * CELL_PX : (row + 1) * CELL_PX, column * CELL_PX : (column + 1) * CELL_PX]


def _expert_steps(agent: npt.NDArray[np.int64], objects: npt.NDArray[np.int64], recipe: tuple[int, ...]) -> int:
    stops = np.stack([agent, *(objects[i] for i in recipe)])
    return int(np.abs(np.diff(stops, axis=0)).sum()) + len(recipe)


def _check_state(
    agent: npt.NDArray[np.int64], objects: npt.NDArray[np.int64], recipe: tuple[int, ...], picked: tuple[int, ...]
) -> None:
    everything = set(range(len(COLOURS)))
    gone = {int(i) for i in np.flatnonzero((objects == _NOWHERE).all(axis=1))}
    lying = objects[[i for i in everything if i not in gone]]
    legal = (
        all(0 <= place < FIELD for place in (*agent, *lying.ravel()))
        and len({(int(row), int(column)) for row, column in lying}) == len(lying)
        and all(len(set(row)) == len(row) and everything.issuperset(row) for row in (recipe, picked))
        and gone == set(picked)
    )
    if not legal:
        raise foreign_snapshot("a snapshot of a state of the grid", "numbers that no state has")


PREDICATES = (
    StatePredicate(AT_LANDMARK, _is_at, needs_reference=True),
    StatePredicate(OBJECT_MOVES, _object_moves, needs_reference=True),
    *(StatePredicate(f"completed/pick-{colour}", partial(_is_picked, colour)) for colour in COLOURS),
)

TASKS = (
    TaskDefinition("grid", "grid", "", SPEC, partial(GridWorld, indicator=True), PREDICATES, version=VERSION),
    TaskDefinition(
        "grid-no-indicator", "grid", "", SPEC, partial(GridWorld, indicator=False), PREDICATES, version=VERSION
    ),
)
