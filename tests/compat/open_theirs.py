"""Opens LeRobot's datasets with freerein and compares every value. Usage: open_theirs.py ROOT."""

import sys
from pathlib import Path

import numpy as np
import scene

from freerein.data import Dataset, LeRobotSource, import_trajectories, verify

images, video = (Path(sys.argv[1]) / name for name in ("images", "video"))
for root in (images, video):
    dataset = Dataset(root)
    assert len(dataset) == len(scene.LENGTHS)
    assert (dataset.spec.fps, dataset.spec.task, dataset.spec.robot_type) == (scene.FPS, "", "arm")
    assert dataset.goal_texts == scene.TASKS
    assert dataset.spec.action.names == scene.ACTION_NAMES
    assert dataset.spec.robot_state_names == scene.STATE_NAMES
    for index, trajectory in enumerate(dataset):
        assert np.array_equal(dataset.robot_state(index), scene.states(index))
        assert np.array_equal(trajectory.actions, scene.actions(index))
        assert np.array_equal(trajectory.terminated, scene.terminations(index))
    assert verify(root) == []

for index, trajectory in enumerate(Dataset(images)):
    assert np.array_equal(trajectory.frames["front"], scene.frames(index, "front"))
    assert np.array_equal(Dataset(images).cached_frames("front")[index], scene.frames(index, "front"))

import_trajectories(LeRobotSource(video), Path(sys.argv[1]) / "imported")
for root in (video, Path(sys.argv[1]) / "imported"):
    for index, trajectory in enumerate(Dataset(root)):
        bright = trajectory.frames["front"][:, 32, :, 0] > 135
        assert [int(row.argmax()) for row in bright] == [scene.bar_at(index, t) for t in range(scene.LENGTHS[index])]
assert Dataset(Path(sys.argv[1]) / "imported").spec == Dataset(video).spec
assert np.array_equal(Dataset(Path(sys.argv[1]) / "imported").robot_state(2), scene.states(2))
print(f"freerein opens lerobot datasets of images and of video: {len(scene.LENGTHS)} trajectories equal")  # noqa: T201
