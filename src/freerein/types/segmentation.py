"""What the segmentation service takes and returns."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.types.common import Image, ModelRef, Timing


@dataclass(frozen=True, eq=False)
class SegmentRequest:
    """One trajectory to label: its frames, as `frames` or as `images`, and the actions executed.

    Attributes:
        model: Which model.
        frames: uint8 (T, H, W, C), C = 1 or 3. Exactly one of `frames` and `images` is given.
        images: One encoded image per timestep, all of one size.
        actions: float32 (T, A) or int64 (T, 1), as the model was trained; None for a model without actions.
        min_segment: Segments shorter than this many timesteps are merged into their neighbours; 0 and 1 keep all.
        smoothing: Standard deviation, in timesteps, of the Gaussian that smooths the confidences; 0 for none.
    """

    model: ModelRef = ModelRef()
    frames: npt.NDArray[np.uint8] | None = None
    images: tuple[Image, ...] = ()
    actions: npt.NDArray[Any] | None = None
    min_segment: int = 0
    smoothing: float = 0.0


@dataclass(frozen=True)
class Segment:
    """A maximal run of timesteps with one skill.

    Attributes:
        start: First timestep.
        end: One past the last timestep.
        skill: The skill's name.
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
        labels: int64 (T,), indices into `skills`.
        confidence: float32 (T,), the probability of each label.
        segments: In order; together they cover [0, T) without gap or overlap.
        skills: The model's skills.
        model: The model that answered.
        timing: Where the time went.
    """

    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    segments: tuple[Segment, ...]
    skills: tuple[str, ...]
    model: ModelRef
    timing: Timing


@dataclass(frozen=True)
class ListSkillsRequest:
    """Asks for one model's skills.

    Attributes:
        model: Which model.
    """

    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class ListSkillsResponse:
    """What a model can label, and what it wants to see.

    Attributes:
        skills: Labels are indices into this list.
        model: The model that this is about.
        height: Height of the frames it was trained on, in pixels; requests must match.
        width: Width, in pixels.
        channels: 1 or 3.
        action_size: Numbers per action; 0 for a model without actions.
        action_choices: How many different actions there are when they are discrete; 0 when they are continuous.
    """

    skills: tuple[str, ...]
    model: ModelRef
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int
