"""The contents of an openpi client's message: images, goal, executed actions, and whether an episode begins.

    observation/<camera>   uint8 (H, W, C), one for each camera
    observation/state      float32 (S,), the robot's own state; ignored for a model that takes none
    prompt                 a text as goal
    recipe                 a list of skills as goal
    goal/<camera>          images as goal: uint8 (H, W, C), or (N, H, W, C) of several to reach in order
    executed_actions       float32 (N, A) or int64 (N, 1), executed since the previous observation
    reset                  bool: an episode begins

A message holds the model's form of goal only, but openpi's runtimes send a `prompt` always: beside another form it is
ignored, and the reply says so. For a single camera `image` is as good as its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput, must_be
from freerein.types.common import Camera, Encoding, Goal, Image, Observation
from freerein.unknown_names import listed, nearest, quoted_name
from freerein_imitation.model.policy import PolicySpec

_ONLY_CAMERA = "image"
_STATE = "observation/state"
_PROMPT = "prompt"
_OTHER_SIZE = "Add resize=fit or resize=crop to the URL; `fit` is what openpi_client.image_tools.resize_with_pad does."
_PROMPT_IGNORED = "`prompt` is ignored: a goal of this model is given by {}."
_HINT = "The metadata sent on connect tells the model's cameras, goals and actions."


@dataclass(frozen=True, eq=False)
class OpenpiObservation:
    """A message of an openpi client.

    Attributes:
        observation: Its images, and the robot's own state.
        goal: Its goal; None where it holds none.
        executed_actions: As in `ActRequest`; None where it does not tell.
        reset: Whether an episode begins.
        note: What the reply should say of it; empty for nothing.
    """

    observation: Observation
    goal: Goal | None
    executed_actions: npt.NDArray[Any] | None
    reset: bool
    note: str = ""


def parse_observation(spec: PolicySpec, message: dict[str, Any], *, resizes: bool = False) -> OpenpiObservation:
    """Returns a policy's inputs from a message; with `resizes`, images may have any height and width.

    Raises:
        InvalidInput: A key is unknown or missing, or a value is of another type, dtype or shape.
    """
    rest = dict(message)
    images = _take_images(rest, "observation", spec.cameras, resizes)
    goal = _take_goal(rest, spec, resizes)
    state = rest.pop(_STATE, None)
    executed, reset = rest.pop("executed_actions", None), rest.pop("reset", False)
    note = _PROMPT_IGNORED.format(spec.goal_form) if rest.pop(_PROMPT, None) is not None else ""
    if rest:
        raise _unknown_keys(spec, rest)
    if len(images) != len(spec.cameras):
        keys = ", ".join(f"`observation/{camera.name}`" for camera in spec.cameras)
        raise InvalidInput(
            f"An observation must hold one image of each camera, {keys}; got {len(images)}.",
            field="observation",
            hint=_HINT,
        )
    if executed is not None and not isinstance(executed, np.ndarray):
        raise _must_be("executed_actions", "an array", executed)
    if state is not None and not isinstance(state, np.ndarray):
        raise _must_be(_STATE, "an array", state)
    if not isinstance(reset, bool):
        raise _must_be("reset", "a boolean", reset)
    return OpenpiObservation(Observation(images, state), goal, executed, reset, note)


def _must_be(name: str, rule: str, got: object) -> InvalidInput:
    return must_be(name, rule, f"a value of type {type(got).__name__}", hint=_HINT)


def _unknown_keys(spec: PolicySpec, rest: dict[str, Any]) -> InvalidInput:
    """Returns the error of keys that the model has no use for, and says where they belong."""
    known = _known_keys(spec)
    meant = {key: _meant(spec, value) or nearest(key, known) for key, value in rest.items()}
    likely = [f"{quoted_name(key)} is probably `{each}`." for key, each in meant.items() if each][:1]
    return InvalidInput(
        f"An observation for this model may hold {', '.join(f'`{key}`' for key in known)}; got {listed(list(rest))}.",
        field="observation",
        hint=" ".join([*likely, _HINT]),
    )


def _meant(spec: PolicySpec, value: object) -> str | None:
    """Returns the key of a model's only camera for a picture; None for other models and values."""
    is_picture = isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.ndim == 3
    return f"observation/{spec.cameras[0].name}" if is_picture and len(spec.cameras) == 1 else None


def _known_keys(spec: PolicySpec) -> list[str]:
    goals = {
        "text": [_PROMPT],
        "recipe": ["recipe"],
        "images": [f"goal/{camera.name}" for camera in spec.cameras],
    }
    observed = [f"observation/{camera.name}" for camera in spec.cameras]
    return [*observed, _STATE, *goals[spec.goal_form], "executed_actions", "reset"]


def _take_goal(rest: dict[str, Any], spec: PolicySpec, resizes: bool) -> Goal | None:
    """Removes the goal in the policy's form, and returns it; None where there is none."""
    if spec.goal_form == "images":
        has_goal = any(key.startswith("goal/") for key in rest)
        return Goal(_take_images(rest, "goal", spec.cameras, resizes)) if has_goal else None
    if spec.goal_form == "text":
        prompt = rest.pop(_PROMPT, None)
        if prompt is not None and not isinstance(prompt, str):
            raise _must_be(_PROMPT, "a text", prompt)
        return None if prompt is None else Goal(text=prompt)
    recipe = rest.pop("recipe", None)
    if recipe is None:
        return None
    if not isinstance(recipe, list) or not all(isinstance(name, str) for name in recipe):
        raise _must_be("recipe", "a list of texts", recipe)
    return Goal(recipe=tuple(recipe))


def _take_images(rest: dict[str, Any], part: str, cameras: Sequence[Camera], resizes: bool) -> tuple[Image, ...]:
    """Removes the images under a part of the message; returns them, one of each camera after the other."""
    views: list[tuple[Image, ...]] = []
    for camera in cameras:
        key = f"{part}/{camera.name}"
        if len(cameras) == 1 and key not in rest:
            key = f"{part}/{_ONLY_CAMERA}"
        if key in rest:
            value = rest.pop(key)
            views.append(_images(value, _seen(value, camera) if resizes else camera, key, is_sequence=part == "goal"))
    counts = {len(each) for each in views}
    if len(counts) > 1:
        raise InvalidInput(
            f"`{part}` must hold as many images of each camera; got {min(counts)} to {max(counts)}.",
            field=part,
            hint="A goal is one image of each camera.",
        )
    return tuple(image for moment in zip(*views, strict=True) for image in moment)


def _seen(value: object, camera: Camera) -> Camera:
    """Returns a camera with the height and width of a picture, or of several."""
    if not isinstance(value, np.ndarray) or value.ndim < 3:
        return camera
    height, width = value.shape[-3:-1]
    return replace(camera, height=height, width=width)


def _images(value: object, camera: Camera, key: str, *, is_sequence: bool) -> tuple[Image, ...]:
    shape = (camera.height, camera.width, camera.channels)
    is_frame = isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.shape[-3:] == shape
    if not isinstance(value, np.ndarray) or not is_frame or 0 in shape or value.ndim > (4 if is_sequence else 3):
        got = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else "no array"
        is_sized = isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.shape[2:] == shape[2:]
        hint = _OTHER_SIZE if is_sized else "Send height, width and channels in this order, or name another model."
        raise must_be(key, f"uint8 of shape {shape}, as in training", got, hint=hint)
    encoding: Encoding = "raw_rgb8" if camera.channels == 3 else "raw_gray8"
    frames = value.reshape(-1, *shape)
    return tuple(Image(encoding, camera.height, camera.width, frame.tobytes(), camera.name) for frame in frames)
