"""A classical follower: matches SIFT features of what it sees with those of the goal image, and turns or drives.

It learns nothing. Matched features give the similarity transform from what it sees to the goal: sideways, it turns;
where the goal is larger, it drives; else it is there. Without enough matches it turns on the spot.

    python -m experiments.chapter3.sift    the imitation service, around this policy

Needs `pip install -c constraints.txt opencv-python-headless`.
"""

import json
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition
from freerein.model_store import ModelStore
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.common import Camera
from freerein_imitation.__main__ import NAME, build
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import CameraFrames, Policy, PolicyOutput, PolicySpec
from freerein_sim.worlds.tasks import tasks

MODULE = "experiments.chapter3.sift"
_CARD, _WORLD = "card.json", "world"
_SIDE = 160
"""Height and width of the frames that it asks for, in pixels: learned policies see 64."""

_RATIO, _LEAST_MATCHES = 0.75, 8
"""Lowe's ratio of distances (Lowe 2004, section 7.1), and the fewest matches that agree on a transform."""

_SIDEWAYS, _LARGER = 0.13, 1.08
"""Shift, as a share of the width, from which it turns: half a turn; and how much larger a goal is that lies ahead."""

_MAX_STEPS = 30
Gray = npt.NDArray[np.uint8]


class SiftPolicy(Policy):
    """The policy in a world whose choices are to stand, drive forward, and turn left and right."""

    def __init__(self, world: str) -> None:
        self._cv2: Any = import_module("cv2")  # not installed for anything else
        task = tasks()[world].spec
        (camera,) = task.cameras
        self._forward, self._left, self._right = (
            task.action.names.index(name) for name in ("forward", "left", "right")
        )
        self.spec = PolicySpec(
            control_dt_s=task.control_dt_s,
            reached_threshold=0.5,
            max_steps_per_goal=_MAX_STEPS,
            cameras=(Camera(camera.name, _SIDE, _SIDE, camera.channels),),
            action=task.action,
            goal_form="images",
        )
        self._sift, self._matcher = self._cv2.SIFT_create(), self._cv2.BFMatcher()

    def encode_goals(self, goals: CameraFrames) -> npt.NDArray[np.float32]:
        """Returns the goals' pixels, gray, float32 (N, side * side)."""
        (frames,) = goals.values()
        return np.stack([_gray(frame).ravel() for frame in frames]).astype(np.float32)

    def step(
        self,
        frames: CameraFrames,
        goals: npt.NDArray[np.float32],
        previous: npt.NDArray[Any],
        recurrent: npt.NDArray[np.float32],
        *_: Any,
        **__: Any,
    ) -> PolicyOutput:
        """Returns the action of each robot, and 1 where it is at its goal; see `Policy.step`."""
        (seen,) = frames.values()
        pairs = zip(map(_gray, seen), goals.astype(np.uint8).reshape(-1, _SIDE, _SIDE), strict=True)
        chosen = [self._choose(*pair) for pair in pairs]
        actions = np.array([self._left if each is None else each for each in chosen], np.int64)
        reached = np.array([each is None for each in chosen], np.float32)
        return PolicyOutput(actions[:, None, None], reached, recurrent, np.ones(len(seen), np.float32))

    def _choose(self, seen: Gray, goal: Gray) -> int | None:
        """Returns the action; None where the robot is there."""
        transform = self._transform(seen, goal)
        if transform is None:
            return self._left
        scale, shift = transform
        if abs(shift) > _SIDEWAYS:
            return self._left if shift > 0 else self._right  # what is seen moves against the turn
        return self._forward if scale > _LARGER else None

    def _transform(self, seen: Gray, goal: Gray) -> tuple[float, float] | None:
        """Returns how much larger the goal is, and how far to the right; None without enough matches."""
        (points, features), (goal_points, goal_features) = (
            self._sift.detectAndCompute(each, None) for each in (seen, goal)
        )
        if features is None or goal_features is None or len(goal_features) < 2:
            return None
        pairs = self._matcher.knnMatch(features, goal_features, k=2)
        good = [first for first, second in pairs if first.distance < _RATIO * second.distance]
        if len(good) < _LEAST_MATCHES:
            return None
        begin = np.array([points[each.queryIdx].pt for each in good], np.float32)
        end = np.array([goal_points[each.trainIdx].pt for each in good], np.float32)
        matrix, agree = self._cv2.estimateAffinePartial2D(
            begin, end, method=self._cv2.RANSAC, ransacReprojThreshold=3.0
        )
        if matrix is None or agree.sum() < _LEAST_MATCHES:
            return None
        middle = np.full(2, _SIDE / 2)
        shift = float(matrix[0, :2] @ middle + matrix[0, 2] - middle[0])
        return float(np.hypot(*matrix[0, :2])), shift / _SIDE


def _gray(frame: npt.NDArray[np.uint8]) -> Gray:
    """Returns a frame (H, W, C) in gray, uint8 (H, W)."""
    weights = np.array([0.299, 0.587, 0.114]) if frame.shape[2] == 3 else np.ones(1)
    return np.asarray(np.rint(frame @ weights), np.uint8)


def publish(world: str, data_dir: Path, *, model_name: str) -> None:
    """Publishes the policy of a world in a data directory.

    Raises:
        FailedPrecondition: OpenCV is not installed.
    """
    if find_spec("cv2") is None:
        raise FailedPrecondition(
            "The row `sift` needs OpenCV, which is not installed.",
            hint="pip install -c constraints.txt opencv-python-headless",
        )
    store, made = ModelStore(data_dir / "models" / NAME), data_dir / "made"
    made.mkdir(parents=True, exist_ok=True)
    (made / _CARD).write_text(json.dumps({_WORLD: world}))
    store.activate(store.publish(model_name, made))


def load(folder: Path, device: str) -> Policy:
    """Returns the policy in a folder: one that `publish` made, or one that was fitted, such as those that ship."""
    card: Mapping[str, str] = json.loads((folder / _CARD).read_bytes())
    return SiftPolicy(card[_WORLD]) if _WORLD in card else METHODS.load(folder, device)


def _build(settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    return build(settings, limits, metrics, health, load=load)


if __name__ == "__main__":
    run(NAME, LearnedSettings, _build)
