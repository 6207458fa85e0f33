"""Opens LeRobot's dataset with freerein and compares every value. Usage: open_theirs.py ROOT."""

import sys
from pathlib import Path

import numpy as np
import scene

from freerein.data import Dataset, verify

dataset = Dataset(Path(sys.argv[1]))
assert len(dataset) == len(scene.LENGTHS)
assert (dataset.spec.fps, dataset.spec.task, dataset.spec.robot_type) == (scene.FPS, "", "arm")
assert dataset.goal_texts == scene.TASKS
assert dataset.spec.action.names == scene.ACTION_NAMES
for index, trajectory in enumerate(dataset):
    assert np.array_equal(trajectory.frames["front"], scene.frames(index, "front"))
    assert np.array_equal(trajectory.actions, scene.actions(index))
    assert np.array_equal(trajectory.terminated, scene.terminations(index))
    assert np.array_equal(dataset.cached_frames("front")[index], scene.frames(index, "front"))
assert verify(Path(sys.argv[1])) == []
print(f"freerein opens a lerobot dataset: {len(dataset)} trajectories equal")  # noqa: T201
