"""Tempos of scripted experts: how fast a skill is executed, and how long the expert hesitates on the way."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tempo:
    """The tempo of one skill.

    Attributes:
        speed: Share of the full speed, in (0, 1].
        hesitation_steps: Steps that are no way forward.
    """

    speed: float
    hesitation_steps: float


def draw_tempo(rng: np.random.Generator, extra_steps: float, *, moving_steps: float, least_speed: float) -> Tempo:
    """Draws which share of a skill's extra steps is slower motion; the others are hesitation.

    Args:
        rng: The generator.
        extra_steps: How many steps longer than at full speed the skill takes.
        moving_steps: How many steps it moves at full speed.
        least_speed: Least share of the full speed.
    """
    slower = min(extra_steps * rng.random(), moving_steps * (1 / least_speed - 1))
    return Tempo(moving_steps / (moving_steps + slower), extra_steps - slower)


def draw_log_uniform(rng: np.random.Generator, least: float, most: float) -> float:
    """Draws a number between two that are greater than zero, whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))
