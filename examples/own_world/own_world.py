"""A world with an expert, to begin your own from: a hand moves over a board and switches on coloured lamps."""

import hashlib
from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera
from freerein_sim.worlds.predicates import Flags, StatePredicate, States
from freerein_sim.worlds.replay import ReplayedWorld
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
    skill_indices,
)

VERSION = 1
"""Raised where the world behaves differently."""

LAMPS = {"red": (230, 60, 60), "green": (60, 200, 80), "blue": (70, 110, 240)}
STEP = 0.08
"""Distance that an action of 1 moves the hand; the board is 1 wide."""

_REACH, _RADIUS, _PRESSED = 0.05, 0.08, 0.5
_OFF = 0.4
"""Brightness of a lamp that is off."""

SPEC = WorldSpec(
    cameras=(Camera("top", 64, 64, 3),),
    action=ActionSpec(size=3, choices=0, names=("dy", "dx", "press"), unit="board", scale=(STEP, STEP, 1.0)),
    control_dt_s=0.1,
    skills=tuple(f"light-{colour}" for colour in LAMPS),  # skills are the expert's: `has_expert` follows
    max_episode_steps=60,
    state_names=("hand.y", "hand.x", *(f"{colour}.{part}" for colour in LAMPS for part in ("y", "x", "lit"))),
)


class LampsWorld:
    """The lamps of a recipe are to be lit. It saves no state: `ReplayedWorld` repeats its actions instead."""

    spec = SPEC
    fingerprint = hashlib.sha256(f"lamps {VERSION} {SPEC}".encode()).hexdigest()

    def __init__(self) -> None:
        self.hand = np.zeros(2)  # y, x
        self.lamps = np.zeros((len(LAMPS), 2))
        self.lit = np.zeros(len(LAMPS), np.bool_)
        self.recipe: tuple[int, ...] = ()

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Places hand and lamps; an empty recipe means all lamps, in any order."""
        drawn = tuple(int(each) for each in rng.permutation(len(LAMPS)))
        self.recipe = skill_indices(SPEC, recipe) or drawn
        cells = rng.choice(9, size=len(LAMPS) + 1, replace=False)  # of 3 x 3, so that nothing overlaps
        places = (np.stack(np.divmod(cells, 3), axis=1) + rng.uniform(0.3, 0.7, (len(cells), 2))) / 3
        self.hand, self.lamps = places[0], places[1:]
        self.lit = np.zeros(len(LAMPS), np.bool_)

    def step(self, action: Action) -> StepResult:
        """Moves the hand; a press switches on the lamp beneath it."""
        check_actions(SPEC.action, action)
        self.hand = np.clip(self.hand + STEP * action[:2], 0, 1)
        if action[2] > _PRESSED:
            self.lit |= np.linalg.norm(self.lamps - self.hand, axis=1) < _REACH
        return StepResult(terminated=False)

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the board from above."""
        check_view(SPEC, camera, height=height, width=width)
        pixels = np.stack(
            np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
        )
        image = np.full((height, width, 3), 30, np.uint8)
        for place, colour, is_lit in zip(self.lamps, LAMPS.values(), self.lit, strict=True):
            image[_disc(pixels, place, _RADIUS)] = np.array(colour) * (1 if is_lit else _OFF)
        image[_disc(pixels, self.hand, _RADIUS / 2)] = 240
        return image

    def truth(self) -> GroundTruth:
        """Returns hand and lamps; the reward is 1 when the lamps of the recipe are lit, and no others."""
        lamps = np.column_stack([self.lamps, self.lit])
        success = set(np.flatnonzero(self.lit)) == set(self.recipe)
        return GroundTruth(np.concatenate([self.hand, lamps.ravel()]), float(success), success)

    def expert(self, skills: Sequence[str], rng: np.random.Generator) -> "LampsExpert":
        """Returns an expert that lights lamps in order, by default those of the episode's recipe."""
        return LampsExpert(self, skill_indices(SPEC, skills) or self.recipe)

    def close(self) -> None:
        """Does nothing."""


class LampsExpert:
    """Moves straight to each lamp, and presses."""

    def __init__(self, world: LampsWorld, skills: tuple[int, ...]) -> None:
        self._world, self._skills = world, skills

    def act(self) -> LabelledAction | None:
        """Returns the next action and its skill; None when all lamps are lit."""
        world = self._world
        wanted = next((skill for skill in self._skills if not world.lit[skill]), None)
        if wanted is None:
            return None
        way = (world.lamps[wanted] - world.hand) / STEP
        move = np.clip(way, -1, 1)
        press = 1.0 if np.linalg.norm(way - move) * STEP < _REACH / 2 else -1.0
        return LabelledAction(np.array([*move, press], np.float32), wanted)

    def succeeded(self) -> bool:
        """Returns whether its lamps are lit."""
        return bool(self._world.lit[list(self._skills)].all())


def _disc(pixels: npt.NDArray[np.float64], centre: npt.NDArray[np.float64], radius: float) -> npt.NDArray[np.bool_]:
    """Returns the pixels within a radius, bool (H, W), of their coordinates (2, H, W)."""
    return np.asarray(np.hypot(*(pixels - centre[:, None, None])) < radius)


def _is_lit(colour: str, states: States) -> Flags:
    """The lamp was off in the first state, and is on."""
    lit = states[..., SPEC.state_names.index(f"{colour}.lit")] > 0  # (N, T)
    return np.asarray(lit & ~lit[:, :1])


TASKS = (
    TaskDefinition(
        "lamps",
        "lamps",
        "",
        SPEC,
        lambda: ReplayedWorld(LampsWorld()),
        tuple(StatePredicate(f"completed/light-{colour}", partial(_is_lit, colour)) for colour in LAMPS),
        version=VERSION,
    ),
)
