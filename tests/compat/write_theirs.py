"""Writes the scene with the real LeRobot, several trajectories to a file. Usage: write_theirs.py ROOT."""

import sys

import numpy as np
import scene
from lerobot.datasets.lerobot_dataset import LeRobotDataset

features = {
    f"observation.images.{camera}": {"dtype": "image", "shape": size, "names": ["height", "width", "channels"]}
    for camera, size in scene.SIZES.items()
    if size[-1] == 3
}
features["next.done"] = {"dtype": "bool", "shape": (1,), "names": None}
features["observation.state"] = {"dtype": "float32", "shape": (2,), "names": None}
features["action"] = {"dtype": "float32", "shape": (len(scene.ACTION_NAMES),), "names": list(scene.ACTION_NAMES)}

dataset = LeRobotDataset.create(
    "freerein/compat",
    root=sys.argv[1],
    fps=scene.FPS,
    robot_type="arm",
    features=features,
    use_videos=False,
    video_backend="pyav",
)
for index, length in enumerate(scene.LENGTHS):
    for t in range(length):
        frame = {key: scene.frames(index, key.split(".")[-1])[t] for key in features if ".images." in key}
        dataset.add_frame(
            {
                **frame,
                "next.done": scene.terminations(index)[t : t + 1],
                "observation.state": np.zeros(2, np.float32),
                "action": scene.actions(index)[t],
                "task": scene.TASKS[index],
            }
        )
    dataset.save_episode()
dataset.finalize()
