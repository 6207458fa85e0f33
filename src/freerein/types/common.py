"""Types that several services share: images, trajectories, cameras, actions, goals, models, timing."""

import re
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.errors import ServiceError, by_code, must_be

Encoding = Literal["raw_rgb8", "raw_gray8", "png", "jpeg", "webp"]

MAX_TEXT = 2000
"""Longest goal text, in characters."""

ACTION_TOLERANCE = 1e-3
"""By how much a number of a continuous action may be out of bounds: it is clipped."""

_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
_ID = re.compile(r"[0-9a-f]{32}")


def is_name(name: str) -> bool:
    """Returns whether a text may be the name of a dataset, model, task, camera or key."""
    return _NAME.fullmatch(name) is not None


def check_name(name: str, *, field: str) -> str:
    """Returns a valid name of a dataset, model, task, camera or key; raises InvalidInput for any other."""
    if not is_name(name):
        rule = "1 to 64 of a-z, 0-9, dot, underscore and dash, beginning with a letter or digit"
        hint = "Choose a name like blocks-demos.v2."
        raise must_be(field, rule, f"{len(name)} characters that do not match", hint=hint)
    return name


def check_id(value: str, *, field: str) -> str:
    """Returns a valid id, 32 lower-case hexadecimal digits; raises InvalidInput for any other."""
    if _ID.fullmatch(value) is None:
        hint = "Use the id that the service returned."
        raise must_be(field, "an id of 32 hexadecimal digits", f"{len(value)} other characters", hint=hint)
    return value


@dataclass(frozen=True, eq=False)
class Image:
    """One encoded image; `freerein.images` decodes it.

    Attributes:
        height, width: Size in pixels; required for the raw encodings, 0 for "as in the file" for the others.
        data: The encoded bytes; for raw encodings height * width * channels bytes, row by row.
        camera: Name of the camera; may be empty for a single camera.
    """

    encoding: Encoding
    height: int
    width: int
    data: bytes
    camera: str = ""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Observations and executed actions of a robot. Never holds ground truth.

    Attributes:
        frames: By camera, uint8 (T, H, W, C) with C = 1 or 3, RGB; frame t precedes action t.
        actions: float32 (T, A) in [-1, 1] if continuous, int64 (T, 1) if discrete.
        skills: The set of skills that occur, sorted: the only label that learners see. Empty when unknown.
        goal_text: The goal in words; empty when unknown, or when the dataset has one for all.
        terminated: bool (T,), whether the episode terminated after action t, as by a crash; None when unknown.
    """

    frames: dict[str, npt.NDArray[np.uint8]]
    actions: npt.NDArray[Any]
    skills: tuple[str, ...] = ()
    goal_text: str = ""
    terminated: npt.NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Camera:
    """A camera of a world or a robot.

    Attributes:
        height, width: Frame size in pixels; of a world, the default of rendering.
        channels: 1 or 3.
    """

    name: str
    height: int
    width: int
    channels: int


@dataclass(frozen=True)
class ActionSpec:
    """The action space.

    Attributes:
        size: Numbers per action.
        choices: Number of choices of a discrete action (int64, size 1); 0 for a continuous one, float32 in [-1, 1].
        names: Meaning of each number, or of each choice.
        unit: Physical unit of `scale`; empty for discrete actions.
        scale: Effect of an action of 1.0, in `unit` per control step, for each number.
        absolute: Whether a continuous action is a target, such as a joint position, and not a change. A robot then
            holds where its last action put it, and not by zeros.
        hold: The choice of a discrete action that leaves the robot where it is; -1 where there is none.
    """

    size: int
    choices: int
    names: tuple[str, ...]
    unit: str = ""
    scale: tuple[float, ...] = ()
    absolute: bool = False
    hold: int = field(default=-1, repr=False)  # fingerprints of worlds hash the repr

    @property
    def dtype(self) -> np.dtype[np.float32] | np.dtype[np.int64]:
        """float32 of continuous actions, int64 of discrete ones."""
        return np.dtype(np.int64) if self.choices else np.dtype(np.float32)

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value of each number of an action."""
        return (0, self.choices - 1) if self.choices else (-1.0, 1.0)

    def normalised(self, actions: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Returns actions (..., size) in the spec's dtype and bounds, where that changes no more than rounding does.

        Whole numbers become float32, and whole float32 int64: many languages write 1.0 as 1 in JSON. What was measured
        may be outside [-1, 1] by `ACTION_TOLERANCE`. Any other number stays as it is, for the caller to refuse.
        """
        if actions.dtype not in (np.int64, np.float32):
            return actions
        with np.errstate(invalid="ignore"):
            cast = actions.astype(self.dtype, copy=False)
            if self.choices:
                return cast if np.array_equal(cast, actions) else actions
            inside = np.clip(cast, *self.bounds)
            is_near = np.abs(cast.astype(np.float64) - inside) <= ACTION_TOLERANCE
        return np.where(is_near, inside, cast)

    def no_action(self) -> npt.NDArray[Any]:
        """Returns the previous action at the start: zeros, float32 (size,), or for discrete actions -1, int64 (1,)."""
        return np.full(self.size, -1 if self.choices else 0, self.dtype)

    def hold_action(self) -> npt.NDArray[Any]:
        """Returns the action that holds: zeros, float32 (size,), or the choice `hold`, int64 (1,), -1 for none.

        Absolute actions hold by the last of them, and not by zeros.
        """
        return np.full(self.size, self.hold if self.choices else 0, self.dtype)

    def nearest_to_hold(self) -> npt.NDArray[Any]:
        """Returns the action that holds, as `hold_action`, or the first choice where none does."""
        hold = self.hold_action()
        return np.zeros_like(hold) if self.choices and self.hold < 0 else hold


@dataclass(frozen=True, eq=False)
class Observation:
    """One observation of a robot.

    Attributes:
        images: One image per camera; for a model with a single camera, `camera` may be empty.
        state: The robot's own state, float32 (S,) in the units of the dataset that the model was fitted to; None for
            none. Models whose spec has a `robot_state_size` of 0 ignore it.
    """

    images: tuple[Image, ...] = ()
    state: npt.NDArray[Any] | None = None


@dataclass(frozen=True, eq=False)
class Goal:
    """The goal of a policy: exactly one of the three forms.

    Attributes:
        images: A goal image, or a sequence of landmarks to reach in order. For a model with several cameras each goal
            is a run of one image per camera, in any order, with `camera` set.
        recipe: Skills to execute in order.
        text: The goal in words, 1 to 2000 characters.
    """

    images: tuple[Image, ...] = ()
    recipe: tuple[str, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class ModelRef:
    """Reference to a model.

    Attributes:
        name: The model's name; empty for the service's default.
        version: First 12 hexadecimal digits of its manifest's sha256; empty for the active one.
    """

    name: str = ""
    version: str = ""


@dataclass(frozen=True)
class Timing:
    """Timing of a reply, in nanoseconds.

    Attributes:
        queue_ns: Time in the queue of the model.
        encode_ns: Time to encode the reply, as far as known when it is sent.
        total_ns: From the start of the first to the end of the last of these.
        batch_size: Items in the model call.
    """

    queue_ns: int = 0
    decode_ns: int = 0
    infer_ns: int = 0
    encode_ns: int = 0
    total_ns: int = 0
    batch_size: int = 0


@dataclass(frozen=True)
class Error:
    """A `freerein.errors.ServiceError` as a stream message; `retry_after_s` is 0 when a retry cannot help."""

    code: str = ""
    detail: str = ""
    field: str = ""
    hint: str = ""
    retry_after_s: float = 0.0


def error_message(error: ServiceError) -> Error:
    """Returns an error as a message."""
    return Error(error.code, error.detail, error.field, error.hint, error.retry_after_s or 0.0)


def error_from(message: Error) -> ServiceError:
    """Returns the error of a message."""
    return by_code(message.code)(
        message.detail, field=message.field, hint=message.hint, retry_after_s=message.retry_after_s or None
    )


@dataclass(frozen=True)
class Draining:
    """Sent on every open stream when the graceful shutdown begins, `deadline_s` seconds before the server closes it."""

    deadline_s: float = 0.0
