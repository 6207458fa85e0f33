"""How long presses take: in `dial` similarly long, in `dial.uneven` some many times as long as others."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from freerein_sim.worlds.tempo import draw_log_uniform

_HASTE, _MOST_EXTRA_STEPS = 0.35, 36
"""Probability of a press at full speed, and how many steps longer than that another may take."""

_UNEVEN_EXTRA_STEPS = (1, 150)
"""Fewest and most extra steps of an uneven press, if they fit into the episode."""


@dataclass(frozen=True)
class Durations:
    """How long presses take.

    Attributes:
        least_speed: Least share of the full speed.
        draw_extra_steps: Draws how many steps longer than at full speed a press takes; at most the spare ones, or 0.
    """

    least_speed: float
    draw_extra_steps: Callable[[np.random.Generator, int], float]


def _draw_even(rng: np.random.Generator, spare_steps: int) -> float:
    most = min(_MOST_EXTRA_STEPS, spare_steps)
    return 0.0 if most <= 0 or rng.random() < _HASTE else float(rng.uniform(0, most))


def _draw_uneven(rng: np.random.Generator, spare_steps: int) -> float:
    return min(draw_log_uniform(rng, *_UNEVEN_EXTRA_STEPS), max(0, spare_steps))


EVEN = Durations(least_speed=0.3, draw_extra_steps=_draw_even)
"""Many presses are at full speed, and the others up to a few times as long."""

UNEVEN = Durations(least_speed=0.1, draw_extra_steps=_draw_uneven)
"""Some presses are many times as long as others, whichever the key and the place in the recipe."""
