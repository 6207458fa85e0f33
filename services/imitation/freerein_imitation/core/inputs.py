"""Parsing and validation of policy inputs: observations, goals and executed actions, as arrays."""

import asyncio
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput, must_be
from freerein.goal_text import ask_back
from freerein.types.common import ACTION_TOLERANCE, MAX_TEXT, Camera, Goal, Image, Observation
from freerein_imitation.core.policy_state import DIGEST_BYTES
from freerein_imitation.core.resizing import Resizer
from freerein_imitation.model.known_texts import KnownText
from freerein_imitation.model.policy import CameraFrames, PolicySpec

MAX_GOALS = 256
_AS_THEY_ARE = Resizer(None)
_RAW = ("raw_rgb8", "raw_gray8")
_INLINE_BYTES = 2**19  # hashed within half a millisecond: not worth a thread
_CAMERAS_HINT = "GetSpec names the cameras of a model."


@dataclass(frozen=True, eq=False)
class Subgoal:
    """One goal of a sequence.

    Attributes:
        digest: Digest of its content.
        content: Images by camera, uint8 (H, W, C), name of a skill, or text.
    """

    digest: bytes
    content: CameraFrames | str


async def parse_frames(spec: PolicySpec, observation: Observation, resizer: Resizer = _AS_THEY_ARE) -> CameraFrames:
    """Returns the frame of each camera, uint8 (H, W, C); encoded images are decoded off the event loop.

    Raises:
        InvalidInput: The observation does not match the policy's spec.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    field, given = "observation.images", observation.images
    if len(given) != len(spec.cameras):
        named = {image.camera for image in given}
        missing = [camera.name for camera in spec.cameras if camera.name not in named]
        without = f", none of {', '.join(missing)}" if missing else ""
        raise InvalidInput(
            f"`{field}` must hold one image of each camera: {_names(spec)}; got {len(given)}{without}.",
            field=field,
            hint=_CAMERAS_HINT,
        )
    if resizer.mode is None and all(image.encoding in _RAW for image in given):
        return _decode_views(spec, given, field, resizer)
    return await asyncio.to_thread(_decode_views, spec, given, field, resizer)


async def parse_goal(spec: PolicySpec, goal: Goal, resizer: Resizer = _AS_THEY_ARE) -> tuple[Subgoal, ...]:
    """Returns the goals in the order in which to reach them; large images are decoded off the event loop.

    Raises:
        InvalidInput: The goal is of another form, empty, too long, or names an unknown skill.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    _check_goal_form(spec, goal)
    if spec.goal_form == "text":
        return (parse_text(spec, goal.text),)
    if spec.goal_form == "recipe":
        return tuple(_parse_skill(spec, name, f"goal.recipe.{i}") for i, name in enumerate(goal.recipe))
    is_raw = all(image.encoding in _RAW for image in goal.images)
    if resizer.mode is None and is_raw and sum(len(image.data) for image in goal.images) < _INLINE_BYTES:
        return _parse_goal_images(spec, goal.images, resizer)
    return await asyncio.to_thread(_parse_goal_images, spec, goal.images, resizer)


def goal_digest(goals: tuple[Subgoal, ...]) -> bytes:
    """Returns the digest of a sequence of goals."""
    return _digest(b"".join(goal.digest for goal in goals))


def parse_previous_action(spec: PolicySpec, executed: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
    """Returns the last executed action, or `ActionSpec.no_action` for none.

    Args:
        spec: Spec of the policy.
        executed: Actions executed since the previous observation, (N, A), or None.

    Raises:
        InvalidInput: The actions do not match the policy's spec.
    """
    action = spec.action
    none = action.no_action()
    if executed is None or executed.shape == (0,):  # the latter is an empty list of JSON
        return none
    executed = action.normalised(executed)
    if executed.dtype != action.dtype or executed.ndim != 2 or executed.shape[1] != action.size:
        rule = f"{action.dtype} of shape (N, {action.size})"
        hint = "GetSpec describes a model's actions."
        raise must_be("executed_actions", rule, f"{executed.dtype} {executed.shape}", hint=hint)
    low, high = action.bounds
    if not ((executed >= low) & (executed <= high)).all():  # False for NaN
        rule = f"finite and in [{low:g}, {high:g}], up to {ACTION_TOLERANCE:g}"
        raise must_be("executed_actions", rule, "others", hint="Scale actions as the model's spec says.")
    last: npt.NDArray[Any] = executed[-1] if len(executed) else none
    return last


def parse_robot_state(spec: PolicySpec, observation: Observation) -> npt.NDArray[np.float32] | None:
    """Returns the robot's own state, float32 (S,); None, whatever the robot sent, for a policy that takes none.

    Raises:
        InvalidInput: The state is missing, does not match the policy's spec, or is not finite.
    """
    shape, state, field = (spec.robot_state_size,), observation.state, "observation.state"
    if not spec.robot_state_size:
        return None
    if state is None or state.dtype != np.float32 or state.shape != shape:
        got = "none" if state is None else f"{state.dtype} {state.shape}"
        hint = "Send what the dataset of the fit holds as `observation.state`, or name a model that takes none."
        raise must_be(field, f"the robot's own state, float32 of shape {shape}, as in training", got, hint=hint)
    if not np.isfinite(state).all():
        hint = "Send finite numbers, and no observation while a sensor fails."
        raise must_be(field, "finite", "NaN or an infinity", hint=hint)
    return state


def elapsed_steps(executed: npt.NDArray[Any] | None) -> int:
    """Returns the control steps since the previous observation: at least one, in which the robot may have held."""
    return len(executed) if executed is not None and executed.ndim == 2 and len(executed) else 1


def _check_goal_form(spec: PolicySpec, goal: Goal) -> None:
    """Checks that a goal is given in the policy's form only, and that its length is in bounds."""
    form, cameras = spec.goal_form, spec.cameras
    given = {"images": len(goal.images), "recipe": len(goal.recipe), "text": len(goal.text)}
    count = given.pop(form)
    size = len(cameras) if form == "images" else 1
    most, unit = (MAX_TEXT, "characters") if form == "text" else (MAX_GOALS, "goals")
    if size > 1:
        unit += f" of {size} images, one of each camera: {_names(spec)},"
    if any(given.values()) or count % size or not 1 <= count // size <= most:
        others = " and ".join(f"{number} of {name}" for name, number in given.items())
        raise InvalidInput(
            f"`goal.{form}` must hold 1 to {most} {unit} for this model, and the other forms none; "
            f"got {count}, {others}.",
            field=f"goal.{form}",
            hint="GetSpec names the form of a model's goals, and its cameras.",
        )


def _parse_goal_images(spec: PolicySpec, goal: tuple[Image, ...], resizer: Resizer) -> tuple[Subgoal, ...]:
    """Returns goals of one image per camera each."""
    size = len(spec.cameras)
    if resizer.mode is None:
        pixels = len(goal) // size * sum(camera.height * camera.width for camera in spec.cameras)
    else:
        pixels = sum(images.pixel_count(image, field=f"goal.images.{i}") for i, image in enumerate(goal))
    images.check_total_pixels(pixels, hint="Send fewer goals.", field="goal.images")
    parts = [
        _decode_views(spec, goal[first : first + size], "goal.images", resizer, first=first)
        for first in range(0, len(goal), size)
    ]
    return tuple(Subgoal(_digest(*(frame.data for frame in frames.values())), frames) for frames in parts)


def _decode_views(
    spec: PolicySpec, views: Sequence[Image], field: str, resizer: Resizer, *, first: int = 0
) -> CameraFrames:
    """Returns the image of each camera, in the spec's order.

    `first` is the index in `field` of the first view, for errors.
    """
    frames: dict[str, npt.NDArray[np.uint8]] = {}
    cameras = {camera.name: camera for camera in spec.cameras}
    if len(cameras) == 1:
        cameras[""] = spec.cameras[0]
    for i, image in enumerate(views, start=first):
        camera = cameras.get(image.camera)
        if camera is None or camera.name in frames:
            several = len(spec.cameras) > 1
            expected = f"one of {_names(spec)}, each once" if several else f"{_names(spec)}, or empty"
            got = "another name" if camera is None else f"{camera.name} again"
            raise must_be(f"{field}.{i}.camera", expected, got, hint=_CAMERAS_HINT)
        frames[camera.name] = _decode(camera, image, f"{field}.{i}", resizer)
    return {camera.name: frames[camera.name] for camera in spec.cameras}


def _decode(camera: Camera, image: Image, field: str, resizer: Resizer) -> npt.NDArray[np.uint8]:
    """Returns an image's pixels; a file whose header names another size is not decoded unless it is to be resized."""
    expected = (camera.height, camera.width, camera.channels)
    resizes = resizer.mode is not None
    if image.encoding in _RAW or resizes or images.pixel_count(image, field=field) == camera.height * camera.width:
        pixels = resizer.resized(images.decode(image, field=field), camera)
        if pixels.shape == expected:
            return pixels
        got, is_of_size = f"{pixels.shape}", pixels.shape[:2] == expected[:2]
    else:
        got, is_of_size = "another size", False
    raise InvalidInput(
        f"`{field}` must have height, width and channels {expected}, as in training; got {got}.",
        field=field,
        hint="Send colour where training had colour, and gray where it had gray."
        if is_of_size
        else "Scale it, ask for `resize`, or name another model.",
    )


def _names(spec: PolicySpec) -> str:
    return ", ".join(camera.name for camera in spec.cameras)


def parse_text(spec: PolicySpec, text: str) -> Subgoal:
    """Returns a text as a goal, in the words of the policy's training; InvalidInput where that cannot be read."""
    if spec.goal_texts or spec.training_texts:
        read = spec.known_texts.read(text)
        followed = _followed(spec, read)
        if followed is None:
            raise _refused_text(spec, read)
        text = followed
    return Subgoal(_digest(text.encode()), text)


def _followed(spec: PolicySpec, read: KnownText) -> str | None:
    return read.training_text or (None if spec.goal_texts else read.caption)


def _refused_text(spec: PolicySpec, read: KnownText) -> InvalidInput:
    if spec.goal_texts:
        expected = f"must be what this policy was trained for: {'; '.join(spec.goal_texts)}"
    else:
        expected = "must say what a training text of this policy says, or relate two of their objects"
    unknown = f", with words that it does not know: {', '.join(read.unknown)}" if read.unknown else ""
    meant = _followed(spec, spec.known_texts.read(read.did_you_mean))
    otherwise = f"Say it in other words, such as: {(spec.goal_texts or spec.training_texts)[0]}."
    return InvalidInput(
        f"`goal.text` {expected}; got another text{unknown}.",
        field="goal.text",
        hint=f"Hold the robot. {ask_back(meant or '', otherwise)} Or name a model that follows others.",
    )


def _parse_skill(spec: PolicySpec, name: str, field: str) -> Subgoal:
    if name not in spec.skills:
        hint = "GetSpec names the skills of a model."
        raise must_be(field, f"one of {', '.join(spec.skills)}", "another name", hint=hint)
    return Subgoal(_digest(name.encode()), name)


def _digest(*parts: Any) -> bytes:
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for part in parts:
        digest.update(part)
    return digest.digest()
