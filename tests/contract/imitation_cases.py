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
from freerein.types.common import ActionSpec, Goal, Image, ModelRef, Observation
from freerein_imitation.model.policy import PolicyOutput, PolicySpec


class Waving:
    """A policy that waves until it sees its goal. It fails where told to."""

    spec = PolicySpec(
        action=ActionSpec(2, 0, ("x", "y"), "m", (0.5, 0.5)),
        control_dt_s=0.1,
        reached_threshold=0.5,
        max_steps_per_goal=10,
        goal_form="images",
        camera="front",
        height=2,
        width=3,
        channels=3,
        horizon=2,
        recurrent_size=1,
    )

    def encode_goals(self, goals: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        return goals[:, 0, 0, :1].astype(np.float32)

    def step(self, frames: npt.NDArray[np.uint8], goals: Any, previous: Any, recurrent: Any) -> PolicyOutput:
        seen = frames[:, 0, 0, :1].astype(np.float32)
        if 1 in seen:
            raise ZeroDivisionError
        after = recurrent + 0.25 + previous[:, :1] + (math.nan if 2 in seen else 0)
        actions = after[:, :, None] * np.ones((1, 2, 2), np.float32)
        return PolicyOutput(
            actions.astype(np.float32), (seen == goals)[:, 0].astype(np.float32), after.astype(np.float32)
        )


def build(data_dir: Path, health: Health, publish_model: Callable[[Path], object]) -> Service:
    """Returns the service, with one model."""
    from freerein.serving.learned import LearnedSettings
    from freerein_imitation.__main__ import build as build_service

    publish_model(data_dir / "models" / "imitation")
    settings = LearnedSettings(data_dir=data_dir)
    return build_service(settings, Limits(), Metrics(), health, load=lambda _folder, _device: Waving())


def image(value: int = 0, *, height: int = 2, camera: str = "front") -> Image:
    return Image("raw_rgb8", height, 3, bytes([value]) * (height * 9), camera)


def act(code: str = "", seen: Image | None = None, **fields: Any) -> tuple[str, Any, str]:
    observation = Observation((seen or image(),))
    values = {"observation": observation, "goal": Goal((image(7), image(8))), **fields}
    return "Act", imitation.ActRequest(**values), code


def cases(version: str) -> tuple[tuple[str, Any, str], ...]:
    """Returns requests of (method, request, code), for a service whose model has that version."""
    done = np.zeros((1, 2), np.float32)
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
        act("invalid_input", seen=image(height=3)),
        act("invalid_input", seen=image(camera="left")),
        act("invalid_input", seen=Image("raw_gray8", 2, 3, bytes(6))),
        act("unsupported_media", seen=Image("png", 0, 0, b"GIF89a")),
        act("invalid_input", goal=Goal()),
        act("invalid_input", goal=Goal(recipe=("reach",))),
        act("invalid_input", goal=Goal(text="wave")),
        act("invalid_input", goal=Goal((image(7),), text="wave")),
        act("invalid_input", goal=Goal((image(), image(height=1)))),
        act("invalid_input", executed_actions=done.astype(np.float64)),
        act("invalid_input", executed_actions=done[:, :1]),
        act("invalid_input", executed_actions=done + np.float32(math.nan)),
        act("invalid_input", executed_actions=done + np.float32(1.5)),
        act("invalid_input", state=b"x"),
        act("model_fault", seen=image(1)),
        act("output_not_finite", seen=image(2)),
    )
