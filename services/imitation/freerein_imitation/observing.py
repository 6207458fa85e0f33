"""What a request says, as arrays that a policy can work on: checked once, here, and trusted afterwards."""

import asyncio
import hashlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.errors import InvalidInput
from freerein.types.common import MAX_TEXT, Goal, Image, Observation
from freerein.types.imitation import GoalForm
from freerein_imitation.acting import Policy, Target
from freerein_imitation.memory import DIGEST_BYTES

MAX_GOALS = 256
GOAL_FORMS: Mapping[str, GoalForm] = MappingProxyType(
    {"goal_conditioned": "images", "skills": "recipe", "language": "text"}
)
"""The form of a policy's goals, by its kind."""

_RAW = ("raw_rgb8", "raw_gray8")
_AT_ONCE_BYTES = 2**19  # what is hashed within half a millisecond need not go to a thread


async def read_frame(policy: Policy, observation: Observation) -> npt.NDArray[np.uint8]:
    """Returns what the policy's camera sees, uint8 (H, W, C); encoded images are decoded off the event loop.

    Raises:
        InvalidInput: The observation is not what the policy was trained on.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    field = "observation.images"
    if len(observation.images) != 1:
        raise InvalidInput(
            f"`{field}` must hold one image, of the camera {policy.camera}; got {len(observation.images)}.",
            field=field,
            hint="GetSpec names the cameras of a model.",
        )
    image = observation.images[0]
    if image.camera not in ("", policy.camera):
        raise InvalidInput(
            f"`{field}.0.camera` must be {policy.camera}, or empty; got the name of another camera.",
            field=f"{field}.0.camera",
            hint="GetSpec names the cameras of a model.",
        )
    if image.encoding in _RAW:
        return _pixels(policy, image, "observation.images.0")
    return await asyncio.to_thread(_pixels, policy, image, "observation.images.0")


async def read_goal(policy: Policy, goal: Goal) -> tuple[Target, ...]:
    """Returns the goals of a policy, in the order in which they are to be reached; large ones, off the event loop.

    Raises:
        InvalidInput: There are none, too many, or some that the policy does not know.
        UnsupportedMedia: An image is not in the encoding that it names.
    """
    form = GOAL_FORMS[policy.kind]
    _check_form(goal, form)
    if form == "text":
        return (Target(_digest(goal.text.encode()), goal.text),)
    if form == "recipe":
        return tuple(_skill(policy, name, f"goal.recipe.{i}") for i, name in enumerate(goal.recipe))
    if all(image.encoding in _RAW for image in goal.images) and sum(len(i.data) for i in goal.images) < _AT_ONCE_BYTES:
        return _goal_images(policy, goal.images)
    return await asyncio.to_thread(_goal_images, policy, goal.images)


def digest_of(targets: tuple[Target, ...]) -> bytes:
    """Returns what tells a whole goal from others."""
    return _digest(b"".join(target.digest for target in targets))


def read_previous(policy: Policy, executed: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
    """Returns the action executed last: float32 (A,), zeros for none, or int64 (1,), -1 for none.

    Args:
        policy: Who acts.
        executed: What was executed since the observation before, (N, A), or None.

    Raises:
        InvalidInput: It is not what the policy knows as actions.
    """
    dtype, none = (np.int64, -1) if policy.action_choices else (np.float32, 0)
    if executed is None:
        return np.full(policy.action_size, none, dtype)
    if executed.dtype != dtype or executed.ndim != 2 or executed.shape[1] != policy.action_size:
        raise InvalidInput(
            f"`executed_actions` must be {np.dtype(dtype)} of shape (N, {policy.action_size}); "
            f"got {executed.dtype} {executed.shape}.",
            field="executed_actions",
            hint="GetSpec says what an action is.",
        )
    low, high = (0, policy.action_choices - 1) if policy.action_choices else (-1.0, 1.0)
    if not ((executed >= low) & (executed <= high)).all():  # False for NaN
        raise InvalidInput(
            f"`executed_actions` must be finite and in [{low:g}, {high:g}]; one is not.",
            field="executed_actions",
            hint="Scale actions as the model's spec says.",
        )
    last: npt.NDArray[Any] = executed[-1] if len(executed) else np.full(policy.action_size, none, dtype)
    return last


def elapsed_steps(executed: npt.NDArray[Any] | None) -> int:
    """Returns the control steps since the observation before: one at least, in which the robot may have held."""
    return len(executed) if executed is not None and executed.ndim == 2 and len(executed) else 1


def _check_form(goal: Goal, form: GoalForm) -> None:
    """Refuses a goal that is not given in one form alone, or is too short or too long."""
    given = {"images": len(goal.images), "recipe": len(goal.recipe), "text": len(goal.text)}
    count = given.pop(form)
    most, things = (MAX_TEXT, "characters") if form == "text" else (MAX_GOALS, "goals")
    if any(given.values()) or not 1 <= count <= most:
        others = " and ".join(f"{number} of {name}" for name, number in given.items())
        raise InvalidInput(
            f"`goal.{form}` must hold 1 to {most} {things} for this model, and nothing else be given; "
            f"got {count}, {others}.",
            field=f"goal.{form}",
            hint="GetSpec says in which form a model takes its goals.",
        )


def _pixels(policy: Policy, image: Image, field: str) -> npt.NDArray[np.uint8]:
    """Returns an image's pixels; a file whose header says another size is never decoded."""
    expected = (policy.height, policy.width, policy.channels)
    if image.encoding in _RAW or images.pixel_count(image, field=field) == policy.height * policy.width:
        pixels = images.decode(image, field=field)
        if pixels.shape == expected:
            return pixels
        got = f"height, width and channels {pixels.shape}"
    else:
        got = "another size"
    raise InvalidInput(
        f"`{field}` must have height, width and channels {expected}, as the model was trained on; got {got}.",
        field=field,
        hint="Scale it, or name another model.",
    )


def _goal_images(policy: Policy, goal: tuple[Image, ...]) -> tuple[Target, ...]:
    frames = [_pixels(policy, image, f"goal.images.{i}") for i, image in enumerate(goal)]
    return tuple(Target(_digest(frame.data), frame) for frame in frames)


def _skill(policy: Policy, name: str, field: str) -> Target:
    if name not in policy.skills:
        raise InvalidInput(
            f"`{field}` must be one of {', '.join(policy.skills)}; got another name.",
            field=field,
            hint="GetSpec names the skills of a model.",
        )
    return Target(_digest(name.encode()), name)


def _digest(content: Any) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest()
