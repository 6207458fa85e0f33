"""Moments in other colours, and where the grounding model finds each of its names in them.

A fit's phrases name few colours. What a network is never asked for it forgets: with these moments it goes on locating
what the grounding model can name, so that a noun outside the fit has a keypoint, too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning.augmentation import turn_hue
from freerein_reward.methods.criterion_captions.captions import HIDDEN, SHOWN, UNSURE, Labels
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset
from freerein_reward.methods.shared.presence import alone_in_place
from freerein_reward.model import PhraseLocator

_LEAST_TURN = 0.2
"""Least turn of the hues either way, as a share of the colour circle: by less, as by `augment_camera`, things keep
their names, for the background turns with them."""


def recolour_moments(
    moments: KeypointDataset,
    grounding: PhraseLocator,
    names: Sequence[str],
    *,
    least: float,
    generator: torch.Generator,
) -> KeypointDataset:
    """Returns moments with all hues turned far, and the keypoints of names in them, as those of phrases.

    A name is shown where the grounding model finds it at the keypoint of a phrase of the moments, and
    finds no other name there with more heat. Elsewhere it is not sure.

    Args:
        moments: The moments; all views of one are turned alike.
        grounding: Tells the names.
        names: Noun phrases of things of each name.
        least: Presence from which a name is surely shown; below 1 minus it, it surely is not.
        generator: Source of the angles, on the CPU.
    """
    turns = _LEAST_TURN + (1 - 2 * _LEAST_TURN) * torch.rand(len(moments), generator=generator)
    frames, keypoints, shown = [], [], []
    for camera, view in enumerate(moments.frames):
        turned = turn_hue(torch.from_numpy(view).permute(3, 0, 1, 2).float() / 255, turns)
        frames.append((255 * turned).round().to(torch.uint8).permute(1, 2, 3, 0).contiguous().numpy())
        found = grounding.ground(frames[-1], names)
        at = np.stack([found.x, found.y], axis=2).astype(np.float32)  # (N, names, 2)
        unit = moments.layout.unit(camera)
        is_alone = alone_in_place(found.x / unit[0], found.y / unit[1], found.presence, found.heat, epsilon=1.0)
        things = np.where(moments.shown[:, camera, :, None] == SHOWN, moments.keypoints[:, camera], np.inf)
        is_sure = is_alone & _is_near(at, things, unit)
        keypoints.append(at)
        shown.append(_shown(found.presence, is_sure, least))
    return replace(moments, frames=tuple(frames), keypoints=np.stack(keypoints, axis=1), shown=np.stack(shown, axis=1))


def _is_near(
    keypoints: npt.NDArray[np.float32], things: npt.NDArray[np.floating], unit: npt.NDArray[np.float64]
) -> npt.NDArray[np.bool_]:
    """Returns whether keypoints (N, K, 2) are less than an object's width from a thing (N, P, 2): bool (N, K)."""
    distance = np.linalg.norm((keypoints[:, :, None] - things[:, None]) / unit, axis=3)  # (N, K, P)
    is_near: npt.NDArray[np.bool_] = distance.min(axis=2) < 1
    return is_near


def _shown(presence: npt.NDArray[np.float64], is_sure: npt.NDArray[np.bool_], least: float) -> Labels:
    hidden = np.where(presence < 1 - least, HIDDEN, UNSURE)
    return np.where(is_sure & (presence >= least), SHOWN, hidden).astype(np.int8)
