"""What more than one service speaks of: images, trajectories, cameras, actions, goals, models, timing."""

import re
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput

Encoding = Literal["raw_rgb8", "raw_gray8", "png", "jpeg", "webp"]

MAX_TEXT = 2000
"""Characters of a goal text, at most."""

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_ID = re.compile(r"[0-9a-f]{32}")


def check_name(name: str, *, field: str) -> str:
    """Returns `name` when it is a legal name of a dataset, model, task, camera or key.

    Raises:
        InvalidInput: `name` does not match `^[a-z0-9][a-z0-9._-]{0,63}$`.
    """
    if _NAME.fullmatch(name) is None:
        raise InvalidInput(
            f"`{field}` must be 1 to 64 of a-z, 0-9, dot, underscore and dash, beginning with a letter or digit; "
            f"got {len(name)} characters that do not match.",
            field=field,
            hint="Choose a name like blocks-demos.v2.",
        )
    return name


def check_id(value: str, *, field: str) -> str:
    """Returns `value` when it is an id that we gave out: 32 lower-case hexadecimal digits.

    Raises:
        InvalidInput: It is not.
    """
    if _ID.fullmatch(value) is None:
        raise InvalidInput(
            f"`{field}` must be an id of 32 hexadecimal digits; got {len(value)} characters that are not one.",
            field=field,
            hint="Use the id that the service returned.",
        )
    return value


@dataclass(frozen=True, eq=False)
class Image:
    """One encoded image as it crosses a wire; `freerein.images` turns it into pixels.

    Attributes:
        encoding: How `data` is to be read.
        height: Rows, in pixels; required for the raw encodings, 0 = "as the data says" for the others.
        width: Columns, in pixels; as `height`.
        data: The encoded bytes; for raw encodings height * width * channels bytes, row by row.
        camera: Which camera took it; may be empty where only one is meant.
    """

    encoding: Encoding
    height: int
    width: int
    data: bytes
    camera: str = ""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What a robot saw and did. It never holds ground truth.

    Attributes:
        frames: By camera, uint8 (T, H, W, C) with C = 1 or 3, RGB; frame t was seen before action t.
        actions: float32 (T, A) in [-1, 1] where continuous, int64 (T, 1) where discrete.
        skills: The set of skills that occur, sorted: the only tag that learners see. Empty when unknown.
        goal_text: What was to be done, in words; empty when unknown, or where the dataset says it for all.
    """

    frames: dict[str, npt.NDArray[np.uint8]]
    actions: npt.NDArray[Any]
    skills: tuple[str, ...] = ()
    goal_text: str = ""


@dataclass(frozen=True)
class Camera:
    """A camera, of a world or of a robot.

    Attributes:
        name: Its name.
        height: Height of its frames, in pixels; of a world, that rendered when none is asked for.
        width: Width of its frames, in pixels; as `height`.
        channels: 1 or 3.
    """

    name: str
    height: int
    width: int
    channels: int


@dataclass(frozen=True)
class ActionSpec:
    """What an action is.

    Attributes:
        size: Numbers per action.
        choices: How many choices there are when it is discrete (int64, size 1); 0 when it is continuous, float32 in
            [-1, 1].
        names: What each number, or each choice, means.
        unit: The physical unit of each number at scale; empty when the action is discrete.
        scale: What an action of 1.0 does, in `unit` per control step, for each number.
    """

    size: int
    choices: int
    names: tuple[str, ...]
    unit: str = ""
    scale: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Observation:
    """What a robot observes at one moment.

    Attributes:
        images: One per camera; where the model sees a single one, `camera` may be left empty.
    """

    images: tuple[Image, ...] = ()


@dataclass(frozen=True, eq=False)
class Goal:
    """What a robot is to achieve: exactly one of the three.

    Attributes:
        images: A goal image, or a sequence of landmarks to reach one after the other.
        recipe: Skills to execute one after the other.
        text: What is to be done, in words, 1 to 2000 characters.
    """

    images: tuple[Image, ...] = ()
    recipe: tuple[str, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class ModelRef:
    """Which model.

    Attributes:
        name: The model's name; empty for the service's default.
        version: First 12 hexadecimal digits of its manifest's sha256; empty for the active one.
    """

    name: str = ""
    version: str = ""


@dataclass(frozen=True)
class Timing:
    """Where a reply's time went.

    Attributes:
        queue_ns: Waiting for the model.
        decode_ns: Turning the request's bytes into arrays.
        infer_ns: In the model.
        encode_ns: Turning arrays into the reply's bytes, as far as known when it is sent.
        total_ns: From the first to the last of these.
        batch_size: How many items shared the model call.
    """

    queue_ns: int = 0
    decode_ns: int = 0
    infer_ns: int = 0
    encode_ns: int = 0
    total_ns: int = 0
    batch_size: int = 0


@dataclass(frozen=True)
class Error:
    """A `ServiceError` as it crosses a stream.

    Attributes:
        code: The error's code, such as `invalid_input`.
        detail: One sentence: what was expected, what came.
        field: The field at fault, or empty.
        hint: How to mend it.
        retry_after_s: Seconds to wait before another try; 0 when that cannot help.
    """

    code: str = ""
    detail: str = ""
    field: str = ""
    hint: str = ""
    retry_after_s: float = 0.0


@dataclass(frozen=True)
class Draining:
    """Sent on every open stream when the service has been told to stop.

    Attributes:
        deadline_s: Seconds until the stream is closed from the server's side.
    """

    deadline_s: float = 0.0
