"""Opens freerein's dataset in the real LeRobot and compares every value. Usage: open_ours.py ROOT."""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scene
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from torch.utils.data import DataLoader

root = Path(sys.argv[1])
dataset = LeRobotDataset("freerein/compat", root=root / "continuous", video_backend="pyav")
assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (len(scene.LENGTHS), sum(scene.LENGTHS), scene.FPS)
assert dataset.meta.features["action"]["names"] == list(scene.ACTION_NAMES)
assert [tuple(skills) for skills in dataset.meta.episodes["skills"]] == list(scene.SKILLS)

row = 0
for index, length in enumerate(scene.LENGTHS):
    for t in range(length):
        item = dataset[row]
        assert (item["task"], int(item["episode_index"]), int(item["frame_index"])) == (scene.TASKS[index], index, t)
        assert abs(float(item["timestamp"]) - t / scene.FPS) < 1e-4
        assert np.array_equal(item["action"].numpy(), scene.actions(index)[t])
        assert bool(item["next.terminated"]) == scene.terminations(index)[t]
        for camera in scene.SIZES:
            pixels = torch.from_numpy(scene.frames(index, camera)[t]).permute(2, 0, 1) / 255
            assert torch.equal(item[f"observation.images.{camera}"], pixels)
        row += 1

actions = np.concatenate([scene.actions(index) for index in range(len(scene.LENGTHS))])
stats = dataset.meta.stats["action"]
assert np.allclose(stats["mean"], actions.mean(axis=0))
assert np.allclose(stats["std"], actions.std(axis=0))
terminations = np.concatenate([scene.terminations(index) for index in range(len(scene.LENGTHS))])
assert np.allclose(dataset.meta.stats["next.terminated"]["mean"], terminations.mean())
front = np.concatenate([scene.frames(index, "front") for index in range(len(scene.LENGTHS))]) / 255
assert np.allclose(dataset.meta.stats["observation.images.front"]["mean"].ravel(), front.mean(axis=(0, 1, 2)))

episode = LeRobotDataset("freerein/compat", root=root / "continuous", episodes=[1], video_backend="pyav")
assert len(episode) == scene.LENGTHS[1]
assert np.array_equal(np.stack([item["action"] for item in episode]), scene.actions(1))
ahead = {"action": [0.0, 1 / scene.FPS]}
window = LeRobotDataset("freerein/compat", root=root / "continuous", delta_timestamps=ahead, video_backend="pyav")
assert np.array_equal(window[0]["action"].numpy(), scene.actions(0)[:2])
assert next(iter(DataLoader(dataset, batch_size=4)))["observation.images.front"].shape == (4, 3, 24, 32)

discrete = LeRobotDataset("freerein/compat", root=root / "discrete", video_backend="pyav")
assert [int(item["action"]) for item in discrete] == [int(choice) for choice in scene.choices(0)[:, 0]]
print(f"lerobot {version('lerobot')} opens a freerein dataset: {row} frames and actions equal")  # noqa: T201
