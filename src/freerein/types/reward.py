"""What the reward service takes and returns. In the shapes, N is the number of frames."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from freerein.types.common import Image, ModelRef, Timing

Mode = Literal["binary", "raw"]


@dataclass(frozen=True, eq=False)
class RewardRequest:
    """Frames, as `frames` or as `images`, and what they are to show.

    Attributes:
        goal_text: What is to be seen.
        frames: By camera, uint8 (N, H, W, C), C = 1 or 3, of any size; cameras that the model does not see are left
            aside. Exactly one of `frames` and `images` is given.
        images: Encoded; those of one camera are in order of time, and every camera has as many.
        rivals: Texts that the goal text must beat; none for the same sentence with every other relation.
        mode: `binary`, 1 where the goal text beats its rivals, else 0; or `raw`, the similarity.
        model: Which model.
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
        rewards: float32 (N,), in the mode asked for.
        similarities: float32 (N,), the cosine of the frame's embedding and the goal text's.
        winners: int64 (N,), the index in `texts` of the one that fits best; 0 is the goal text, which wins no tie.
        texts: The goal text, then its rivals.
        truncated: Whether a text was too long for the model and was cut.
        unknown_words: How many words of the goal text the model has never seen.
        model: The model that answered.
        timing: Where the time went.
    """

    rewards: npt.NDArray[np.float32]
    similarities: npt.NDArray[np.float32]
    winners: npt.NDArray[np.int64]
    texts: tuple[str, ...]
    truncated: bool
    unknown_words: int
    model: ModelRef
    timing: Timing


@dataclass(frozen=True, eq=False)
class GroundRequest:
    """An image, and what to find in it.

    Attributes:
        image: Of any size.
        phrases: Noun phrases; each is told from the others.
        model: Which grounding model.
    """

    image: Image
    phrases: tuple[str, ...]
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class Grounding:
    """Where a phrase is in an image.

    Attributes:
        phrase: The phrase.
        heatmap: float32 (H, W) in [0, 1], of the image's size: its Grad-CAM.
        x: The pixel that is meant, counted from the left edge.
        y: Counted from the upper edge.
        presence: How sure the model is that the image shows it at all, in [0, 1].
    """

    phrase: str
    heatmap: npt.NDArray[np.float32]
    x: float
    y: float
    presence: float


@dataclass(frozen=True, eq=False)
class GroundResponse:
    """One grounding per phrase, in the request's order.

    Attributes:
        groundings: The groundings.
        model: The model that answered.
        timing: Where the time went.
    """

    groundings: tuple[Grounding, ...]
    model: ModelRef
    timing: Timing


@dataclass(frozen=True, eq=False)
class DescribeRequest:
    """Images, and the things to tell of.

    Attributes:
        images: Of any sizes.
        phrases: Noun phrases.
        epsilon: How near counts as near: the things' width as a share of the image's; None for 0.1.
        model: Which grounding model.
    """

    images: tuple[Image, ...]
    phrases: tuple[str, ...]
    epsilon: float | None = None
    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class Description:
    """What can be said of one image: a caption for each ordered pair of phrases that it shows."""

    captions: tuple[str, ...]


@dataclass(frozen=True)
class DescribeResponse:
    """One description per image, in the request's order.

    Attributes:
        descriptions: The descriptions.
        model: The model that answered.
        timing: Where the time went.
    """

    descriptions: tuple[Description, ...]
    model: ModelRef
    timing: Timing


@dataclass(frozen=True)
class EmbedGoalRequest:
    """A text to embed.

    Attributes:
        goal_text: The text.
        model: Which reward model.
    """

    goal_text: str
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class EmbedGoalResponse:
    """A text's embedding.

    Attributes:
        embedding: float32 (D,), of length 1.
        truncated: Whether the text was too long for the model and was cut.
        unknown_words: How many words of the text the model has never seen.
        model: The model that answered.
        timing: Where the time went.
    """

    embedding: npt.NDArray[np.float32]
    truncated: bool
    unknown_words: int
    model: ModelRef
    timing: Timing
