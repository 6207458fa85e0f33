"""Where blocks are in frames of the front camera, from true states, and how far off the grounding model finds them."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from experiments.robustness.draw import Drawn
from experiments.robustness.reward_model import COLOURS, PHRASES, open_grounding
from experiments.robustness.worlds import CAMERA, SCATTERED
from freerein_reward.model.grounding import PhraseLocations
from freerein_sim.worlds.blocks.scene import CAMERAS
from freerein_sim.worlds.tasks import tasks

_LEAST_X_M = -0.1
"""What is farther back is behind the wall."""

Pixels = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Found:
    """Blocks in M frames, in the order of `COLOURS`.

    Attributes:
        places: True columns and rows, float64 (M, 4, 2).
        is_shown: bool (M, 4); places of others mean nothing.
        located: What the grounding model says.
        errors: Distance of the place that it says, in pixels, float64 (M, 4).
    """

    places: Pixels
    is_shown: npt.NDArray[np.bool_]
    located: PhraseLocations
    errors: Pixels


def find_blocks(drawn: Drawn) -> Found:
    """Returns where the blocks of frames are, and where the grounding model that ships finds them."""
    frames, states = drawn.seen["frames"], drawn.truth["states"]
    names = tasks()[SCATTERED].spec.state_names
    columns = [[names.index(f"{colour}.{axis}") for axis in "xyz"] for colour in COLOURS]
    points = states[:, columns]  # (M, 4, 3)
    places = project(points, size=frames.shape[1])
    located = open_grounding().locate(frames, PHRASES)
    said = np.stack([located.x, located.y], axis=2) * frames.shape[1]
    return Found(places, points[..., 0] > _LEAST_X_M, located, np.linalg.norm(said - places, axis=2))


def project(points: npt.NDArray[np.float64], *, size: int) -> Pixels:
    """Returns columns and rows, float64 (..., 2), of points (..., 3) in metres, in square frames of a front camera."""
    at, to, fovy_deg = CAMERAS[CAMERA]
    ahead = np.subtract(to, at) / np.linalg.norm(np.subtract(to, at))
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    offset = points - np.array(at)
    depth = offset @ ahead
    half = math.tan(math.radians(fovy_deg) / 2)
    across, up = offset @ right / (half * depth), offset @ np.cross(right, ahead) / (half * depth)  # in [-1, 1]
    return size / 2 * np.stack([1 + across, 1 - up], axis=-1)
