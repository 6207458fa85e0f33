"""How long presses take: in `dial` similarly long, in `dial.uneven` some many times as long as others."""

from typing import Protocol

import numpy as np

from freerein_sim.worlds.tempo import draw_log_uniform

_HASTE, _MOST_EXTRA_STEPS = 0.35, 36
"""Probability of a press at full speed, and how many steps longer than that another may take."""

_UNEVEN_EXTRA_STEPS = (1, 150)
"""Fewest and most extra steps of an uneven press, if they fit into the episode."""


class Durations(Protocol):
    """Draws how long presses take."""

    @property
    def least_speed(self) -> float:
        """Least share of the full speed."""

    def draw_extra_steps(self, rng: np.random.Generator, spare_steps: int) -> float:
        """Draws how many steps longer than at full speed a press takes; at most the episode's spare ones, or 0."""


class EvenDurations:
    """Many presses are at full speed, and the others up to a few times as long."""

    least_speed = 0.3

    def draw_extra_steps(self, rng: np.random.Generator, spare_steps: int) -> float:
        """Draws 0, or uniformly."""
        most = min(_MOST_EXTRA_STEPS, spare_steps)
        return 0.0 if most <= 0 or rng.random() < _HASTE else float(rng.uniform(0, most))


class UnevenDurations:
    """Some presses are many times as long as others, whichever the key and the place in the recipe."""

    least_speed = 0.1

    def draw_extra_steps(self, rng: np.random.Generator, spare_steps: int) -> float:
        """Draws log-uniformly."""
        return min(draw_log_uniform(rng, *_UNEVEN_EXTRA_STEPS), max(0, spare_steps))
