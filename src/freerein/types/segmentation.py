"""Requests and responses of the segmentation service."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.types.common import Image, ModelRef, Timing

NO_SKILL = -1
"""Label of a timestep whose segment was rejected."""


@dataclass(frozen=True, eq=False)
class SegmentRequest:
    """One trajectory: its frames, as `frames` or as `images`, and the executed actions.

    Attributes:
        frames: uint8 (T, H, W, C), C = 1 or 3. Exactly one of `frames` and `images` is given.
        images: Encoded images, one per timestep, all of one size.
        actions: float32 (T, A) or int64 (T, 1), as in training; None for a model without actions.
        min_segment: Shortest segment in timesteps; shorter ones are merged into a neighbour. 0 and 1 keep all.
        smoothing: Standard deviation of the temporal Gaussian filter, in timesteps; 0 for none.
        min_kept: Shortest segment in timesteps that is kept, after merging; the timesteps of shorter ones are
            rejected: they have no skill. 0 and 1 keep all.
    """

    model: ModelRef = ModelRef()
    frames: npt.NDArray[np.uint8] | None = None
    images: tuple[Image, ...] = ()
    actions: npt.NDArray[Any] | None = None
    min_segment: int = 0
    smoothing: float = 0.0
    min_kept: int = 0


@dataclass(frozen=True)
class Segment:
    """A maximal run of timesteps with one skill.

    Attributes:
        start: First timestep.
        end: One past the last timestep.
        confidence: Mean confidence of its timesteps, in [0, 1].
    """

    start: int
    end: int
    skill: str
    confidence: float


@dataclass(frozen=True, eq=False)
class SegmentResponse:
    """One label per timestep, and the segments that they form.

    Attributes:
        labels: int64 (T,), indices into `skills`; `NO_SKILL` where the segment was rejected.
        confidence: float32 (T,), probability of each label; of a rejected one, that of the skill that it had.
        in_distribution: float32 (T,) in [0, 1], how much each prediction, before smoothing, is like those on held-out
            data; see `freerein.learning.in_distribution`.
        segments: In order, without overlap; between them lie the rejected timesteps. Without rejection they cover
            [0, T).
    """

    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]
    segments: tuple[Segment, ...]
    skills: tuple[str, ...]
    model: ModelRef
    timing: Timing


@dataclass(frozen=True)
class ListSkillsRequest:
    """Requests the skills of a model."""

    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class ListSkillsResponse:
    """Skills and expected inputs of a model; its frames have this height and width in pixels, and 1 or 3 channels.

    Attributes:
        skills: The skills; labels are indices into this list.
        action_size: Numbers per action; 0 for a model without actions.
        action_choices: Number of discrete actions; 0 for continuous ones.
    """

    skills: tuple[str, ...]
    model: ModelRef
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int
