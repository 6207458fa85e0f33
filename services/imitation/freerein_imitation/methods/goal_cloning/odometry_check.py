"""Whether places tell held-out sums of actions: where they do not, a goal recognizer by odometry cannot be relied on.

It is so of actions that do not displace the robot, such as joint targets, and of limits that move zero: sums then grow
with time alone, wherever the robot is.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from freerein_imitation.methods.goal_cloning.goal_windows import GoalWindows, sample_goal_pairs
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork

_TOLD = 0.9  # of the error of constant places: `blocks` has 0.5 and 0.7, absolute targets of the same motion 0.99
_STILL = 0.1  # of the largest distance of nearby places


@torch.no_grad()
def odometry_warnings(
    network: GoalCloningNetwork, windows: Sequence[GoalWindows], rng: np.random.Generator, *, max_goal_steps: int
) -> list[str]:
    """Returns a warning where places tell sums of continuous actions hardly better than constant places do.

    Axes that do not count for a goal, or along which the robot hardly moves, are left out.
    `windows` are held-out ones, from which pairs of observation and goal are sampled.
    """
    recognizer, action = network.recognizer, network.spec.action
    parts = [_errors(network, each, rng, max_goal_steps=max_goal_steps) for each in windows]
    learned, constant = torch.stack(parts).mean(dim=0)  # (A,) each
    is_untold = recognizer.counts & (constant > _STILL * recognizer.tolerance) & (learned > _TOLD * constant)
    if not is_untold.any():
        return []
    names = action.names or tuple(str(number) for number in range(action.size))
    errors = [each[is_untold].mean().item() for each in (learned, constant)]
    untold = ", ".join(f"`{names[number]}`" for number in is_untold.nonzero()[:, 0].tolist())
    return [
        f"Actions must displace the robot; held-out images do not tell the sums of {untold}: the error is "
        f"{errors[0]:.2f} actions, that of constant places {errors[1]:.2f}. "
        "The goal-reached flag cannot be relied on. Record differences of positions, scaled by symmetric limits, so "
        "that 0 is no motion; or fit with method=goal_conditioned."
    ]


def _errors(
    network: GoalCloningNetwork, windows: GoalWindows, rng: np.random.Generator, *, max_goal_steps: int
) -> Tensor:
    """Returns the mean absolute errors of places, and of constant ones, of pairs of some windows: float32 (2, A)."""
    pairs = sample_goal_pairs(windows, rng, max_goal_steps=max_goal_steps)
    places = network.recognizer.places(network.encoder(windows.frames))  # (N, A)
    moved = windows.odometer[pairs.goals] - windows.odometer[pairs.observations]  # (P, A)
    estimated = places[pairs.goals] - places[pairs.observations]
    return torch.stack([estimated - moved, moved]).abs().mean(dim=1)
