"""The doom world: a first-person view of rooms and corridors, run by ViZDoom's engine."""

import hashlib
import math
from collections.abc import Collection, Sequence
from functools import partial
from typing import Protocol

import numpy as np
import numpy.typing as npt
from PIL import Image

from freerein.errors import FailedPrecondition, InvalidInput
from freerein_sim.worlds.doom import maps
from freerein_sim.worlds.doom.engine import Engine, EngineObservation
from freerein_sim.worlds.doom.floor import AHEAD_UNITS, CELL_UNITS
from freerein_sim.worlds.doom.maps import DoomMap
from freerein_sim.worlds.doom.spec import ALONG_PATH, start_spot
from freerein_sim.worlds.recipes import check_one
from freerein_sim.worlds.walkable_grid import WalkableGrid
from freerein_sim.worlds.world import (
    Action,
    Frame,
    GroundTruth,
    MakeExpert,
    ScriptedPolicy,
    StepResult,
    WorldSpec,
    check_actions,
    check_view,
    skill_indices,
)

_FORMAT_VERSION = 1


class MakeDoomExpert(Protocol):
    """Makes an expert of a world."""

    def __call__(self, world: "DoomWorld", skills: Sequence[str], rng: np.random.Generator) -> ScriptedPolicy:
        """Returns the expert."""


class DoomWorld:
    """The world; its engine starts with the first episode. It has no goal.

    Args:
        spec: The task's spec.
        doom_map: The map.
        floor: Where its player can walk.
        make_expert: Makes its experts.
        conditions: Conditions of the task.
    """

    def __init__(
        self,
        spec: WorldSpec,
        doom_map: DoomMap,
        floor: WalkableGrid,
        make_expert: MakeDoomExpert,
        conditions: Collection[str] = (),
    ) -> None:
        self.spec = spec
        self.map = doom_map
        self.floor = floor
        self.recipe: tuple[str, ...] = ()
        self._file = doom_map.wad()
        self._start_spot = start_spot(conditions)
        self._starts_along_path = ALONG_PATH in conditions
        self._engine: Engine | None = None
        self._seen: EngineObservation | None = None
        self._has_ended = False
        self.expert: MakeExpert = partial(make_expert, self)

    @property
    def fingerprint(self) -> str:
        """Hash of the format version, what is read of ViZDoom's wheel, the map and the spec."""
        parts = f"doom {_FORMAT_VERSION} {maps.wheel_hash()} {hashlib.sha256(self._file).hexdigest()} {self.spec}"
        return hashlib.sha256(parts.encode()).hexdigest()

    @property
    def pose(self) -> npt.NDArray[np.float64]:
        """Place in map units and heading in degrees: float64 (3,), x, y, heading."""
        return self._now().pose

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Draws a spot of the map and a heading; with a path, begins where it does.

        Raises:
            InvalidInput: The recipe is not one path, or the conditions say where to begin, too.
            WorkerLost: The engine has ended.
        """
        skill_indices(self.spec, recipe)
        check_one(recipe, kind="path")
        self._check_start(recipe)
        spot, heading = int(rng.choice(list(self.map.spots))), float(rng.uniform(0, 360))
        if self._start_spot is not None:
            spot = self._start_spot
        if recipe:
            spot, _ = self.map.routes[recipe[0]]
            heading = self._first_direction(recipe[0]) if self._starts_along_path else heading
        if self._engine is None or not self._engine.is_running:
            self._engine = Engine(self._file)
        self._seen = self._engine.begin(self.map.spots[spot], heading)
        self.recipe, self._has_ended = tuple(recipe), False

    def step(self, action: Action) -> StepResult:
        """Holds the choice for four tics. The vest of map A ends an episode.

        Raises:
            WorkerLost: The engine has ended.
        """
        check_actions(self.spec.action, action)
        if self._engine is None:
            raise _not_begun()
        if not self._has_ended:
            seen = self._engine.act(int(action[0]))
            self._has_ended = seen is None
            self._seen = seen or self._seen
        return StepResult(terminated=self._has_ended)

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns what the player sees, in gray; of the last action before the vest where that ended the episode."""
        check_view(self.spec, camera, height=height, width=width)
        image = Image.fromarray(self._now().frame).resize((width, height), Image.Resampling.BILINEAR)
        return np.array(image, np.uint8)[..., None]

    def truth(self) -> GroundTruth:
        """Returns the pose; there is no goal to reach."""
        return GroundTruth(self.pose.copy(), 0.0, success=False)

    def close(self) -> None:
        """Ends the engine; may be called twice."""
        if self._engine is not None:
            self._engine.close()
            self._engine = None

    def _now(self) -> EngineObservation:
        if self._seen is None:
            raise _not_begun()
        return self._seen

    def _check_start(self, recipe: Sequence[str]) -> None:
        if recipe and self._start_spot is not None:
            raise InvalidInput(
                f"An episode with a path begins where that does; got {recipe[0]} and a condition of the group `start`.",
                field="skills",
                hint="Leave out one of them.",
            )

    def _first_direction(self, path: str) -> float:
        """Returns the heading in which a path begins, in degrees."""
        begin, end = (np.array(place, np.float64) for place in self.map.ends(path))
        way = self.floor.way(begin, end)
        x, y = way[min(round(AHEAD_UNITS / CELL_UNITS), len(way) - 1)] - begin
        return math.degrees(math.atan2(y, x)) % 360


def _not_begun() -> FailedPrecondition:
    return FailedPrecondition("A world is stepped in an episode; none has begun.", hint="Reset it first.")
