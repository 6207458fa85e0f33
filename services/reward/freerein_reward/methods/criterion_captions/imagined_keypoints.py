"""Synthetic keypoints without images: their captions cost nothing, and rare captions are learned from them."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from freerein_reward.methods.criterion_captions.captions import HIDDEN, SHOWN, Labels
from freerein_reward.methods.criterion_captions.keypoint_dataset import ViewLayout
from freerein_reward.methods.criterion_captions.network import MAX_NOUNS

_HIDDEN, _GONE = 0.1, 0.1
"""Share of nouns that a camera does not show, and of those that none does."""

_NEAR, _NEAR_WIDTHS = 0.8, 1.0
"""Share of nouns near the one before, and the standard deviation of their distances, in object widths."""

_PRESENCE_NOISE = 0.1
"""Largest difference of a presence from 0 and 1."""


class ImaginedKeypoints(NamedTuple):
    """Keypoints of `MAX_NOUNS` nouns in N scenes, seen by V cameras.

    Attributes:
        keypoints: float32 (N, V, nouns, 2), x and y as fractions of width and height.
        presence: float32 (N, V, nouns), as a network might see it.
        shown: int8 (N, V, nouns), `SHOWN` or `HIDDEN`.
    """

    keypoints: npt.NDArray[np.float32]
    presence: npt.NDArray[np.float32]
    shown: Labels


def imagine_keypoints(count: int, layout: ViewLayout, rng: np.random.Generator) -> ImaginedKeypoints:
    """Returns random keypoints, most of them near others, independent in each camera."""
    cameras = sorted({camera for camera in layout.cameras if camera is not None})
    units = np.stack([layout.unit(camera) for camera in cameras])[:, None]  # (V, 1, 2)
    size = (count, len(cameras), MAX_NOUNS)
    keypoints = rng.uniform(size=(*size, 2))
    for noun in range(1, MAX_NOUNS):
        near = keypoints[:, :, noun - 1] + _NEAR_WIDTHS * units[:, 0] * rng.normal(size=(count, len(cameras), 2))
        is_near = rng.random((count, len(cameras), 1)) < _NEAR
        keypoints[:, :, noun] = np.where(is_near, near.clip(0, 1), keypoints[:, :, noun])
    is_hidden = (rng.random(size) < _HIDDEN) | (rng.random((count, 1, MAX_NOUNS)) < _GONE)
    presence = np.abs(np.where(is_hidden, 0.0, 1.0) - _PRESENCE_NOISE * rng.random(size))
    shown = np.where(is_hidden, HIDDEN, SHOWN).astype(np.int8)
    return ImaginedKeypoints(keypoints.astype(np.float32), presence.astype(np.float32), shown)
