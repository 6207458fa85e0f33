"""Parsing and validation of policy inputs: observations, goals and executed actions, as arrays."""

import asyncio
import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput
from freerein.types.common import MAX_TEXT, Goal, Image, Observation
from freerein_imitation.core.policy_state import DIGEST_BYTES
from freerein_imitation.model.policy import PolicySpec

MAX_GOALS = 256
_RAW = ("raw_rgb8", "raw_gray8")
_INLINE_BYTES = 2**19  # hashed within half a millisecond: not worth a thread


@dataclass(frozen=True, eq=False)
class Subgoal:
    """One goal of a sequence.

    Attributes:
        digest: Digest of its content.
        content: Image, uint8 (H, W, C), name of a skill, or text.
    """

    digest: bytes
    content: npt.NDArray[np.uint8] | str


async def parse_frame(spec: PolicySpec, observation: Observation) -> npt.NDArray[np.uint8]:
    """Returns the frame of the policy's camera, uint8 (H, W, C); encoded images are decoded off the event loop.

    Raises:
        InvalidInput: The observation does not match the policy's spec.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    field = "observation.images"
    if len(observation.images) != 1:
        raise InvalidInput(
            f"`{field}` must hold one image, of the camera {spec.camera}; got {len(observation.images)}.",
            field=field,
            hint="GetSpec names the cameras of a model.",
        )
    image = observation.images[0]
    if image.camera not in ("", spec.camera):
        raise InvalidInput(
            f"`{field}.0.camera` must be {spec.camera}, or empty; got the name of another camera.",
            field=f"{field}.0.camera",
            hint="GetSpec names the cameras of a model.",
        )
    if image.encoding in _RAW:
        return _decode(spec, image, "observation.images.0")
    return await asyncio.to_thread(_decode, spec, image, "observation.images.0")


async def parse_goal(spec: PolicySpec, goal: Goal) -> tuple[Subgoal, ...]:
    """Returns the goals in the order in which to reach them; large images are decoded off the event loop.

    Raises:
        InvalidInput: The goal is of another form, empty, too long, or names an unknown skill.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    _check_goal_form(spec, goal)
    if spec.goal_form == "text":
        return (Subgoal(_digest(goal.text.encode()), goal.text),)
    if spec.goal_form == "recipe":
        return tuple(_parse_skill(spec, name, f"goal.recipe.{i}") for i, name in enumerate(goal.recipe))
    is_raw = all(image.encoding in _RAW for image in goal.images)
    if is_raw and sum(len(image.data) for image in goal.images) < _INLINE_BYTES:
        return _parse_goal_images(spec, goal.images)
    return await asyncio.to_thread(_parse_goal_images, spec, goal.images)


def goal_digest(goals: tuple[Subgoal, ...]) -> bytes:
    """Returns the digest of a sequence of goals."""
    return _digest(b"".join(goal.digest for goal in goals))


def parse_previous_action(spec: PolicySpec, executed: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
    """Returns the last executed action, or `PolicySpec.no_action` for none.

    Args:
        spec: Spec of the policy.
        executed: Actions executed since the previous observation, (N, A), or None.

    Raises:
        InvalidInput: The actions do not match the policy's spec.
    """
    none, action = spec.no_action(), spec.action
    if executed is None:
        return none
    if executed.dtype != none.dtype or executed.ndim != 2 or executed.shape[1] != action.size:
        raise InvalidInput(
            f"`executed_actions` must be {none.dtype} of shape (N, {action.size}); "
            f"got {executed.dtype} {executed.shape}.",
            field="executed_actions",
            hint="GetSpec describes a model's actions.",
        )
    low, high = (0, action.choices - 1) if action.choices else (-1.0, 1.0)
    if not ((executed >= low) & (executed <= high)).all():  # False for NaN
        raise InvalidInput(
            f"`executed_actions` must be finite and in [{low:g}, {high:g}]; one is not.",
            field="executed_actions",
            hint="Scale actions as the model's spec says.",
        )
    last: npt.NDArray[Any] = executed[-1] if len(executed) else none
    return last


def elapsed_steps(executed: npt.NDArray[Any] | None) -> int:
    """Returns the control steps since the previous observation: at least one, in which the robot may have held."""
    return len(executed) if executed is not None and executed.ndim == 2 and len(executed) else 1


def _check_goal_form(spec: PolicySpec, goal: Goal) -> None:
    """Checks that a goal is given in the policy's form only, and that its length is in bounds."""
    form = spec.goal_form
    given = {"images": len(goal.images), "recipe": len(goal.recipe), "text": len(goal.text)}
    count = given.pop(form)
    most, unit = (MAX_TEXT, "characters") if form == "text" else (MAX_GOALS, "goals")
    if any(given.values()) or not 1 <= count <= most:
        others = " and ".join(f"{number} of {name}" for name, number in given.items())
        raise InvalidInput(
            f"`goal.{form}` must hold 1 to {most} {unit} for this model, and the other forms none; "
            f"got {count}, {others}.",
            field=f"goal.{form}",
            hint="GetSpec names the form of a model's goals.",
        )


def _decode(spec: PolicySpec, image: Image, field: str) -> npt.NDArray[np.uint8]:
    """Returns an image's pixels; a file whose header names another size is not decoded."""
    expected = (spec.height, spec.width, spec.channels)
    if image.encoding in _RAW or images.pixel_count(image, field=field) == spec.height * spec.width:
        pixels = images.decode(image, field=field)
        if pixels.shape == expected:
            return pixels
        got = f"{pixels.shape}"
    else:
        got = "another size"
    raise InvalidInput(
        f"`{field}` must have height, width and channels {expected}, as the model was trained on; got {got}.",
        field=field,
        hint="Scale it, or name another model.",
    )


def _parse_goal_images(spec: PolicySpec, goal: tuple[Image, ...]) -> tuple[Subgoal, ...]:
    frames = [_decode(spec, image, f"goal.images.{i}") for i, image in enumerate(goal)]
    return tuple(Subgoal(_digest(frame.data), frame) for frame in frames)


def _parse_skill(spec: PolicySpec, name: str, field: str) -> Subgoal:
    if name not in spec.skills:
        raise InvalidInput(
            f"`{field}` must be one of {', '.join(spec.skills)}; got another name.",
            field=field,
            hint="GetSpec names the skills of a model.",
        )
    return Subgoal(_digest(name.encode()), name)


def _digest(content: Any) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest()
