"""Requests and responses of the reward service; N is the number of frames."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from freerein.types.common import Draining, Error, Image, ModelRef, Timing

Mode = Literal["binary", "raw"]


@dataclass(frozen=True, eq=False)
class RewardRequest:
    """Frames, as `frames` or as `images`, and a goal text.

    Attributes:
        frames: uint8 (N, H, W, C) by camera, C = 1 or 3, of any size; other cameras than the model's are ignored.
            Exactly one of `frames` and `images` is given.
        images: Encoded images; those of one camera in temporal order, the same number for every camera.
        goal_text: Description of the goal. Sentences of two of the model's noun phrases and a relation are read by a
            grammar; other texts are compared as they are.
        rivals: Texts that the goal text must beat, read as it is; empty for the goal text with every other relation,
            and that one of its objects is missing.
        mode: `binary`, 1 where the goal text beats all rivals, else 0; or `raw`, the similarity.
    """

    goal_text: str
    frames: dict[str, npt.NDArray[np.uint8]] = field(default_factory=dict)
    images: tuple[Image, ...] = ()
    rivals: tuple[str, ...] = ()
    mode: Mode = "binary"
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class RewardResponse:
    """One reward per frame.

    Attributes:
        rewards: float32 (N,), in the requested mode; in the mode `binary` 0 where `unknown` is not empty.
        similarities: float32 (N,), similarity of frame and goal text, in [-1, 1].
        winners: int64 (N,), index in `texts` of the most similar text; 0 is the goal text, which loses ties, and loses
            to every rival where `unknown` is not empty.
        texts: The goal text, then its rivals, as they were compared: what the grammar can read is in the words of the
            model's training.
        truncated: Whether any text was too long for the model and was truncated.
        in_distribution: float32 (N,) in [0, 1], how much each answer is like those on held-out data; see
            `freerein.learning.in_distribution`; 0 where `unknown` is not empty. Empty for a grounding model.
        unknown: Words of the goal text that the model does not know, distinct and in order; at most 16 of at most 32
            characters each, longer ones cut.
        did_you_mean: Where the goal text is no statement, the nearest one, which was not taken for it; empty where none
            is near.
    """

    rewards: npt.NDArray[np.float32]
    similarities: npt.NDArray[np.float32]
    winners: npt.NDArray[np.int64]
    texts: tuple[str, ...]
    truncated: bool
    in_distribution: npt.NDArray[np.float32]
    unknown: tuple[str, ...]
    model: ModelRef
    timing: Timing
    did_you_mean: str = ""


@dataclass(frozen=True)
class RewardHello:
    """Opens a reward stream; `goal_text`, `rivals` and `mode` are those of `RewardRequest`.

    Attributes:
        model: The model; the stream keeps its version.
    """

    goal_text: str
    rivals: tuple[str, ...] = ()
    mode: Mode = "binary"
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class RewardFrame:
    """One moment, seen by every camera of the model; exactly one of `frames` and `images` is given.

    Attributes:
        seq: Sequence number; must increase, gaps are fine.
        frames: uint8 (H, W, C) by camera, C = 1 or 3, of any size that the stream keeps; other cameras than the model's
            are ignored.
        images: Encoded images, one of each camera.
    """

    seq: int
    frames: dict[str, npt.NDArray[np.uint8]] = field(default_factory=dict)
    images: tuple[Image, ...] = ()


@dataclass(frozen=True, eq=False)
class RewardStreamRequest:
    """A message to a reward stream: either a Hello, which is the first and only one, or a frame."""

    hello: RewardHello | None = None
    frame: RewardFrame | None = None


@dataclass(frozen=True)
class RewardStreamOpened:
    """The model of a reward stream, and how it read the goal text.

    Attributes:
        model: The model that answers.
        cameras: Its cameras; one empty name for any image.
        texts, truncated, unknown, did_you_mean: As in `RewardResponse`.
    """

    model: ModelRef
    cameras: tuple[str, ...]
    texts: tuple[str, ...]
    truncated: bool
    unknown: tuple[str, ...]
    did_you_mean: str = ""


@dataclass(frozen=True)
class FrameReward:
    """The reward of one frame, as `RewardResponse` has it of a request of that frame alone.

    Attributes:
        reward: In the mode of the Hello.
        similarity: Of frame and goal text, in [-1, 1].
        winner: Index in `texts` of `RewardStreamOpened`.
        in_distribution: In [0, 1], 0 where the goal text has unknown words; None for a grounding model.
    """

    reward: float
    similarity: float
    winner: int
    timing: Timing
    in_distribution: float | None = None


@dataclass(frozen=True)
class RewardStreamResponse:
    """A message from a reward stream: exactly one of `opened`, `reward`, `error` and `draining`.

    Attributes:
        seq: The `seq` that a reward or an error answers.
    """

    seq: int = 0
    opened: RewardStreamOpened | None = None
    reward: FrameReward | None = None
    error: Error | None = None
    draining: Draining | None = None


@dataclass(frozen=True, eq=False)
class GroundRequest:
    """An image of any size, and the phrases to locate in it.

    Attributes:
        phrases: Distinct noun phrases; they compete with each other, and with the names that the model knows and no
            phrase says.
    """

    image: Image
    phrases: tuple[str, ...]
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class Grounding:
    """Location of a phrase in an image.

    Attributes:
        heatmap: Grad-CAM, float32 (H, W) in [0, 1], of the image's size; 0 for an unknown phrase.
        x: Horizontal position in pixels from the left edge.
        y: Vertical position in pixels from the upper edge.
        presence: Probability that the image shows the phrase, in [0, 1]; 0 for an unknown phrase. Below 0.5, `x` and
            `y` mean nothing.
    """

    phrase: str
    heatmap: npt.NDArray[np.float32]
    x: float
    y: float
    presence: float


@dataclass(frozen=True)
class UnknownPhrase:
    """A phrase that the grounding model does not know.

    Attributes:
        words: Its words that the model does not know, as in `RewardResponse`. Empty where it knows every word, but does
            not tell what they name from other things better than it does for words without meaning.
    """

    phrase: str
    words: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class GroundResponse:
    """Groundings in the order of the request's phrases.

    Attributes:
        unknown: Words of the phrases that the model does not know, as in `RewardResponse`.
        unknown_phrases: The phrases that the model does not know; their presence is 0.
    """

    groundings: tuple[Grounding, ...]
    model: ModelRef
    timing: Timing
    unknown: tuple[str, ...]
    unknown_phrases: tuple[UnknownPhrase, ...]


@dataclass(frozen=True, eq=False)
class DescribeRequest:
    """Images of any sizes, and the distinct noun phrases to caption them with.

    Attributes:
        epsilon: Object width as a fraction of the image width; None for 0.1.
    """

    images: tuple[Image, ...]
    phrases: tuple[str, ...]
    epsilon: float | None = None
    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class Description:
    """Captions of one image, one for each ordered pair of phrases that it shows."""

    captions: tuple[str, ...]


@dataclass(frozen=True)
class DescribeResponse:
    """Descriptions in the order of the request's images.

    Attributes:
        unknown: Words of the phrases that the model does not know, as in `RewardResponse`.
        unknown_phrases: The phrases that the model does not know; no caption mentions them.
    """

    descriptions: tuple[Description, ...]
    model: ModelRef
    timing: Timing
    unknown: tuple[str, ...]
    unknown_phrases: tuple[UnknownPhrase, ...]


@dataclass(frozen=True)
class EmbedGoalRequest:
    """A goal text to embed with a reward model."""

    goal_text: str
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class EmbedGoalResponse:
    """A text's embedding.

    Attributes:
        embedding: float32 (D,), of length 1 at most.
        truncated: Whether the text was too long for the model and was truncated.
        unknown: Words that the model does not know, as in `RewardResponse`.
        did_you_mean: The nearest statement, as in `RewardResponse`.
    """

    embedding: npt.NDArray[np.float32]
    truncated: bool
    unknown: tuple[str, ...]
    model: ModelRef
    timing: Timing
    did_you_mean: str = ""
