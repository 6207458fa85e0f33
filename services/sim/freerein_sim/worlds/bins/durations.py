"""How long moves take: in `bins` similarly long, in `bins.uneven` some many times as long as others."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.tempo import Tempo, draw_log_uniform, draw_tempo

Steps = npt.NDArray[np.float64]
"""float64 (count,): steps of each move."""

PLAIN_STEPS = 17
"""Steps of a move at full speed without stumbles."""

_STUMBLING_STEPS, _MAX_STUMBLING_STEPS = 14.0, 40.0
_UNEVEN_EXTRA_STEPS = (1, 180)
"""Fewest and most extra steps of an uneven move, if they fit into the episode."""

_MOVING_STEPS, _LEAST_SPEED = 8, 0.1
"""Steps that the gripper is on its way in a move at full speed, and its least share of that speed."""


DrawTempos = Callable[[np.random.Generator, int, int], Sequence[Tempo]]
"""Draws the tempo of each of a number of moves; unless many fail, all end within the steps of an episode."""


def even_tempos(rng: np.random.Generator, count: int, max_steps: int) -> Sequence[Tempo]:
    """Draws moves at full speed, and how long each stumbles, exponentially."""
    drawn = np.minimum(rng.exponential(_STUMBLING_STEPS, size=count), _MAX_STUMBLING_STEPS)
    return [Tempo(1.0, steps) for steps in _fit(drawn, max_steps)]


def uneven_tempos(rng: np.random.Generator, count: int, max_steps: int) -> Sequence[Tempo]:
    """Draws how many steps longer each move is, log-uniformly, and which share of them it moves slowly.

    Some are many times as long as others, whichever the grocery and the place in the recipe.
    """
    drawn = np.array([draw_log_uniform(rng, *_UNEVEN_EXTRA_STEPS) for _ in range(count)])
    return [
        draw_tempo(rng, extra, moving_steps=_MOVING_STEPS, least_speed=_LEAST_SPEED) for extra in _fit(drawn, max_steps)
    ]


def _fit(extra_steps: Steps, max_steps: int) -> Steps:
    """Returns the extra steps, all shortened alike where they are more than an episode has."""
    spare = max(0.0, max_steps - len(extra_steps) * PLAIN_STEPS)
    return np.asarray(extra_steps * min(1.0, spare / max(extra_steps.sum(), 1e-9)))
