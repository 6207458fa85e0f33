"""The imitation service's row of the contract suite: a policy that waves, requests and their outcomes."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types import imitation
from freerein.types.common import ActionSpec, Camera, Goal, Image, ModelRef, Observation
from freerein_imitation.model.policy import CameraFrames, Policy, PolicyOutput, PolicySpec

CAMERAS = (Camera("front", 2, 3, 3), Camera("wrist", 4, 2, 1))


class Waving(Policy):
    """A policy that waves until it sees its goal with all of its cameras. It fails where told to."""

    def __init__(self, cameras: tuple[Camera, ...], *, robot_state_size: int = 0) -> None:
        self.spec = PolicySpec(
            control_dt_s=0.1,
            reached_threshold=0.5,
            max_steps_per_goal=10,
            cameras=cameras,
            action=ActionSpec(2, 0, ("x", "y"), "m", (0.5, 0.5)),
            goal_form="images",
            horizon=2,
            robot_state_size=robot_state_size,
            recurrent_size=1,
        )

    def encode_goals(self, goals: CameraFrames) -> npt.NDArray[np.float32]:
        return np.stack([goals[camera.name][:, 0, 0, 0] for camera in self.spec.cameras], axis=1).astype(np.float32)

    def step(
        self, frames: CameraFrames, goals: Any, previous: Any, recurrent: Any, robot_state: Any = None
    ) -> PolicyOutput:
        seen = self.encode_goals(frames)
        if 1 in seen:
            raise ZeroDivisionError
        after = recurrent + 0.25 + previous[:, :1] + (math.nan if 2 in seen else 0)
        actions = after[:, :, None] * np.ones((1, 2, 2), np.float32) + (
            0 if robot_state is None else np.sum(robot_state)
        )
        if robot_state is not None:
            actions = actions + np.sum(robot_state)
        return PolicyOutput(
            actions.astype(np.float32),
            (seen == goals).all(axis=1).astype(np.float32),
            after.astype(np.float32),
            (1 / (1 + seen[:, 0])).astype(np.float32),
        )


def build(data_dir: Path, health: Health, publish_model: Callable[[Path, str], object]) -> Service:
    """Returns the service, with a model of one camera, one of two, and one that takes its robot's own state."""
    from freerein.serving.learned import LearnedSettings
    from freerein_imitation.__main__ import build as build_service

    def load(folder: Path, _device: str) -> Waving:
        name = folder.parent.name
        return Waving(CAMERAS if name == "two-cameras" else CAMERAS[:1], robot_state_size=2 * (name == "with-state"))

    for name in ("", "two-cameras", "with-state"):
        publish_model(data_dir / "models" / "imitation", name)
    return build_service(LearnedSettings(data_dir=data_dir), Limits(), Metrics(), health, load=load)


def image(value: int = 0, *, camera: str = "front") -> Image:
    return Image("raw_rgb8", 2, 3, bytes([value]) * 18, camera)


def wrist(value: int = 0, *, camera: str = "wrist") -> Image:
    return Image("raw_gray8", 4, 2, bytes([value]) * 8, camera)


def act(code: str = "", seen: Image | None = None, **fields: Any) -> tuple[str, Any, str]:
    observation = Observation((seen or image(),))
    values = {"observation": observation, "goal": Goal((image(7), image(8))), **fields}
    return "Act", imitation.ActRequest(**values), code


def act_two(code: str = "", *seen: Image, goal: tuple[Image, ...] = ()) -> tuple[str, Any, str]:
    """Returns an `Act` with two cameras, towards two goals, of which the second names its cameras in another order."""
    goal = goal or (image(7), wrist(7), wrist(8), image(8))
    observation = Observation(seen or (image(), wrist()))
    return "Act", imitation.ActRequest(observation, Goal(goal), model=ModelRef("two-cameras")), code


def act_with_state(code: str = "", state: npt.NDArray[Any] | None = None) -> tuple[str, Any, str]:
    """Returns an `Act` of the model that takes its robot's own state, of two numbers."""
    observation = Observation((image(),), state)
    return "Act", imitation.ActRequest(observation, Goal((image(7),)), model=ModelRef("with-state")), code


def act_batch(code: str = "", *requests: tuple[str, Any, str]) -> tuple[str, Any, str]:
    return "ActBatch", imitation.ActBatchRequest(tuple(request for _, request, _ in requests)), code


def cases(version: str) -> tuple[tuple[str, Any, str], ...]:
    """Returns requests of (method, request, code), for a service whose model has that version."""
    done, felt = np.zeros((1, 2), np.float32), np.array([-30.5, 12.0], np.float32)
    return (
        ("GetSpec", imitation.GetSpecRequest(), ""),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("default", version)), ""),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("other")), "failed_precondition"),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("", "0" * 12)), "not_found"),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("", "../x")), "invalid_input"),
        act(),
        act(executed_actions=done, max_steps_per_goal=3, model=ModelRef("default", version)),
        act(executed_actions=done[:0]),
        act(seen=image(7)),
        act(seen=image(7), goal=Goal((image(7),))),
        act(seen=image(camera="")),
        act("failed_precondition", model=ModelRef("other")),
        act("invalid_input", observation=Observation()),
        act("unsupported_media", seen=Image("png", 0, 0, b"GIF89a")),
        act("invalid_input", goal=Goal()),
        act("invalid_input", goal=Goal(text="wave")),
        act("invalid_input", executed_actions=done + np.float32(math.nan)),
        act("invalid_input", state=b"x"),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("two-cameras")), ""),
        act_two(),
        act_two("", wrist(7), image(7)),
        act_two("", image(7), wrist(8)),
        act_two("invalid_input", wrist(camera="front"), image(camera="wrist")),
        ("GetSpec", imitation.GetSpecRequest(ModelRef("with-state")), ""),
        act_with_state("", felt),
        act_with_state("invalid_input"),
        act_with_state("invalid_input", felt * np.float32(math.nan)),
        act(observation=Observation((image(),), felt * np.float32(math.nan))),
        ("PublishPolicy", imitation.PublishPolicyRequest("0" * 32), "not_found"),
        ("PublishPolicy", imitation.PublishPolicyRequest("../run"), "invalid_input"),
        act_batch("", act(), act(seen=image(7), goal=Goal((image(7),))), act(state=b"", max_steps_per_goal=3)),
        act_batch("invalid_input"),
        act_batch("invalid_input", act(), act(state=b"x")),
        act_batch("invalid_input", act(), act_two()),
        act_batch("failed_precondition", act(), act(model=ModelRef("other"))),
        act_batch("output_not_finite", act(), act(seen=image(2))),
        act("model_fault", seen=image(1)),
        act("output_not_finite", seen=image(2)),
    )
