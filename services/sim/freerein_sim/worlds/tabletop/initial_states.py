"""Initial states of hand and things, as pure functions of a generator. They do not depend on the skills that follow."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.tabletop.scene import OPENING_M, PAD_M
from freerein_sim.worlds.tabletop.things import FREE_BODIES, SCALED, THINGS

_COLUMNS, _ROWS = 5, 2
_PITCH_Y_M, _PITCH_X_M = 0.19, 0.18
_JITTER_M = 0.024
_FARTHEST_COLUMNS = 2
"""Greatest distance between a thing and what it is used on, so that quick demonstrations stay possible."""

_YAW_RAD = 0.3
_HAND_LOW = np.array([-0.32, -0.2, 0.1, 0.3, -0.3])
_HAND_HIGH = np.array([-0.22, 0.2, 0.18, 0.8, 0.3])

_CELLS_M = np.stack(
    [
        (np.arange(_COLUMNS * _ROWS) // _COLUMNS - (_ROWS - 1) / 2) * _PITCH_X_M,
        (np.arange(_COLUMNS * _ROWS) % _COLUMNS - (_COLUMNS - 1) / 2) * _PITCH_Y_M,
    ],
    axis=1,
)


@dataclass(frozen=True, eq=False)
class InitialState:
    """State before the first action.

    Attributes:
        places_m: By name, x and y of each thing's origin, on the table or on the pad.
        yaws_rad: By name, how far each free body is turned.
        hand: float64 (5,), x, y, z in metres, pitch and roll in radians.
        opening_m: Distance between the fingers.
    """

    places_m: dict[str, npt.NDArray[np.float64]]
    yaws_rad: dict[str, float]
    hand: npt.NDArray[np.float64]
    opening_m: float


def draw(rng: np.random.Generator, on_show: Collection[str] = SCALED) -> InitialState:
    """Draws hand and things; things that are not on show lie on the pad, in the same arrangement."""
    while True:
        cells = dict(zip(SCALED, rng.permutation(len(SCALED)), strict=True))
        columns = {name: cell % _COLUMNS for name, cell in cells.items()}
        if all(abs(columns[each.name] - columns[each.used_on]) <= _FARTHEST_COLUMNS for each in THINGS):
            break
    jitter = rng.uniform(-_JITTER_M, _JITTER_M, size=(len(SCALED), 2))
    places = {name: _CELLS_M[cell] + off for (name, cell), off in zip(cells.items(), jitter, strict=True)}
    for name in set(SCALED).difference(on_show):
        places[name] = places[name] + PAD_M[:2]
    yaws = rng.uniform(-_YAW_RAD, _YAW_RAD, size=len(FREE_BODIES))
    return InitialState(
        places_m=places,
        yaws_rad=dict(zip(FREE_BODIES, yaws.tolist(), strict=True)),
        hand=rng.uniform(_HAND_LOW, _HAND_HIGH),
        opening_m=float(rng.uniform(*OPENING_M)),
    )
