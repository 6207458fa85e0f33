"""Requests and responses of the segmentation service."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.types.common import Draining, Error, Image, ModelRef, Timing

NO_SKILL = -1
"""Label of a timestep that was rejected."""

FLAGGED = 0.03
"""Answers with a lower `in_distribution` are to be taken as outside of what a model was fitted on."""


@dataclass(frozen=True, eq=False)
class SegmentRequest:
    """One trajectory: its frames, as `frames`, `images` or `video`, and the executed actions.

    Attributes:
        frames: uint8 (T, H, W, C), C = 1 or 3. Exactly one of `frames`, `images` and `video` is given.
        images: Encoded images, one per timestep, all of one size.
        actions: float32 (T, A) or int64 (T, 1), as in training, one per timestep; None for a model without actions.
        min_segment: Shortest segment in timesteps; shorter ones are merged into a neighbour. 0 and 1 keep all.
        smoothing: Standard deviation of the temporal Gaussian filter, in timesteps; 0 for none.
        min_kept: Shortest segment in timesteps that is kept, after merging; the timesteps of shorter ones are
            rejected: they have no skill. 0 and 1 keep all.
        video: An mp4 or mov file, in the model's size unless `resize` is set. Its timesteps are what it shows at `fps`
            times per second; frames are left out, or repeated.
        resize: Whether frames of `video` are resized to the model's height and width, whatever their aspect ratio.
        min_confidence: Least confidence that is kept, in [0, 1], before short segments are rejected; timesteps below it
            have no skill. 0 keeps all.
        fps: Timesteps per second of `video`; 0 for those that the model was trained on. Where these are unknown, too,
            each frame is a timestep.
    """

    model: ModelRef = ModelRef()
    frames: npt.NDArray[np.uint8] | None = None
    images: tuple[Image, ...] = ()
    actions: npt.NDArray[Any] | None = None
    min_segment: int = 0
    smoothing: float = 0.0
    min_kept: int = 0
    video: bytes = b""
    resize: bool = False
    min_confidence: float = 0.0
    fps: float = 0.0


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
        time_s: float32 (T,), when each timestep of a `video` is, in seconds; (0,) for the other forms.
        fps: Timesteps per second at which `video` was sampled; 0 where each frame was a timestep, and for the other
            forms.
    """

    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]
    segments: tuple[Segment, ...]
    skills: tuple[str, ...]
    model: ModelRef
    timing: Timing
    time_s: npt.NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    fps: float = 0.0


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
        lag: Timesteps after a timestep that its prediction depends on; None for a model of whole trajectories, which
            has no streams.
        camera: Name of the camera whose frames the model was trained on, as in its dataset.
        fps: Timesteps per second of what the model was trained on; 0 where its card does not say.
    """

    skills: tuple[str, ...]
    model: ModelRef
    height: int
    width: int
    channels: int
    action_size: int
    action_choices: int
    lag: int | None = None
    camera: str = ""
    fps: float = 0.0


@dataclass(frozen=True)
class SegmentHello:
    """Model and options of a segment stream, as in `SegmentRequest`; the stream keeps the model's version.

    Short segments cannot be merged in a stream: that looks at the whole trajectory.
    """

    model: ModelRef = ModelRef()
    smoothing: float = 0.0
    min_kept: int = 0
    min_confidence: float = 0.0


@dataclass(frozen=True, eq=False)
class Timesteps:
    """The next timesteps of a trajectory, one or several, as in `SegmentRequest`.

    Attributes:
        seq: Sequence number; must increase, gaps are fine.
    """

    seq: int
    frames: npt.NDArray[np.uint8] | None = None
    images: tuple[Image, ...] = ()
    actions: npt.NDArray[Any] | None = None


@dataclass(frozen=True, eq=False)
class SegmentStreamRequest:
    """A message to a segment stream: either a Hello, which is the first and only one, or timesteps."""

    hello: SegmentHello | None = None
    timesteps: Timesteps | None = None


@dataclass(frozen=True)
class SegmentStreamOpened:
    """The model of a segment stream.

    Attributes:
        model: Its skills and expected inputs.
        lag: Timesteps after which a label is final at the latest: lookahead of the model, of smoothing and of
            rejection together.
    """

    model: ListSkillsResponse
    lag: int


@dataclass(frozen=True, eq=False)
class StreamLabels:
    """Labels of consecutive timesteps of a segment stream.

    Attributes:
        start: First timestep of `labels`.
        labels, confidence, in_distribution: (n,), final, as in `SegmentResponse`.
        segments: Segments that ended, or with the stream, in order.
        provisional: int64 (m,), labels of the timesteps that follow, up to the newest, as if the trajectory ended
            there; later ones may differ.
    """

    start: int
    labels: npt.NDArray[np.int64]
    confidence: npt.NDArray[np.float32]
    in_distribution: npt.NDArray[np.float32]
    segments: tuple[Segment, ...]
    provisional: npt.NDArray[np.int64]
    timing: Timing


@dataclass(frozen=True, eq=False)
class SegmentStreamResponse:
    """A message from a segment stream: exactly one of `opened`, `labels`, `error` and `draining`.

    Attributes:
        seq: The `seq` that labels or an error answer; 0 after the last message.
        opened: Answer to the Hello.
        labels: Labels that became final, and provisional ones; after the client has ended the stream, all that are
            left.
        error: Why timesteps were rejected.
        draining: The service is stopping: send the trajectory again, to another replica.
    """

    seq: int = 0
    opened: SegmentStreamOpened | None = None
    labels: StreamLabels | None = None
    error: Error | None = None
    draining: Draining | None = None
