"""Moments as other cameras would have seen them, in other lights, with things in front that no phrase names."""

from dataclasses import replace

import numpy as np
import torch

from freerein.learning.augmentation import CameraTakes
from freerein_reward.methods.criterion_captions.captions import HIDDEN, SHOWN, UNSURE
from freerein_reward.methods.criterion_captions.distractors import add_distractors
from freerein_reward.methods.criterion_captions.keypoint_dataset import KeypointDataset


def augment_moments(
    moments: KeypointDataset, strength: float, *, distractors: float, generator: torch.Generator
) -> KeypointDataset:
    """Returns moments whose frames are augmented, and whose keypoints moved with them; all views of a moment alike.

    Args:
        moments: The moments.
        strength: Of the camera augmentation; at 0 the moments are returned as they are.
        distractors: Strength of the distractors, which cover nothing that may be shown.
        generator: Source of all draws, on the CPU.
    """
    if not strength:
        return moments
    height, width = moments.frames[0].shape[1:3]
    takes = CameraTakes.draw(len(moments), (height, width), strength=strength, generator=generator)
    keypoints, may_be_shown = torch.from_numpy(moments.keypoints), torch.from_numpy(moments.shown != HIDDEN)
    frames = []
    for camera, view in enumerate(moments.frames):
        clearance = torch.from_numpy(moments.layout.unit(camera) / 2).float()
        strewn = add_distractors(
            torch.from_numpy(view),
            keypoints[:, camera],
            may_be_shown[:, camera],
            clearance=clearance,
            strength=distractors,
            generator=generator,
        )
        frames.append(takes.of(strewn, generator).numpy())
    moved = moments.keypoints - takes.offsets.flip(1).numpy()[:, None, None] / np.array([width, height])
    is_outside = ((moved < 0) | (moved > 1)).any(axis=3) & (moments.shown == SHOWN)
    shown = np.where(is_outside, UNSURE, moments.shown).astype(np.int8)
    return replace(moments, frames=tuple(frames), keypoints=moved.astype(np.float32), shown=shown)
