"""Opens freerein's dataset in the real LeRobot and compares every value. Usage: open_ours.py ROOT."""

import os
import re
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scene
import torch
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets.compute_stats import aggregate_stats, get_feature_stats
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.processor import NormalizerProcessorStep
from torch.utils.data import DataLoader


def quantiles(values: np.ndarray) -> dict[str, np.ndarray]:
    """Returns LeRobot's statistics of values (T, D), or of images (T, C, H, W) in [0, 255]."""
    stats = get_feature_stats(values, axis=(0, 2, 3) if values.ndim == 4 else 0, keepdims=values.ndim == 4)
    return {k: v if k == "count" or values.ndim == 2 else np.squeeze(v / 255, axis=0) for k, v in stats.items()}


def front_planes(index: int) -> np.ndarray:
    """Returns frames as LeRobot's statistics take them, uint8 (T, C, H, W)."""
    return scene.frames(index, "front").transpose(0, 3, 1, 2)


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
        assert np.array_equal(item["observation.state"].numpy(), scene.states(index)[t])
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
values = {"action": scene.actions, "observation.state": scene.states, "observation.images.front": front_planes}
for feature, of_trajectory in values.items():
    theirs = aggregate_stats([{feature: quantiles(of_trajectory(index))} for index in range(len(scene.LENGTHS))])
    for name in ("q01", "q10", "q50", "q90", "q99"):
        # LeRobot's are of histograms, whose bins are this wide at most.
        widest = (dataset.meta.stats[feature]["max"] - dataset.meta.stats[feature]["min"]) / 5000 + 1e-6
        assert np.all(np.abs(dataset.meta.stats[feature][name] - theirs[feature][name]) <= widest), (feature, name)
features = {"action": PolicyFeature(FeatureType.ACTION, (len(scene.ACTION_NAMES),))}
normalise = NormalizerProcessorStep(features, {FeatureType.ACTION: NormalizationMode.QUANTILES}, dataset.meta.stats)
low, high = (torch.from_numpy(dataset.meta.stats["action"][name]).float() for name in ("q01", "q99"))
assert torch.allclose(normalise._normalize_action(torch.stack([low, high]), inverse=False).abs(), torch.ones(2, 3))

episode = LeRobotDataset("freerein/compat", root=root / "continuous", episodes=[1], video_backend="pyav")
assert len(episode) == scene.LENGTHS[1]
assert np.array_equal(np.stack([item["action"] for item in episode]), scene.actions(1))
ahead = {"action": [0.0, 1 / scene.FPS]}
window = LeRobotDataset("freerein/compat", root=root / "continuous", delta_timestamps=ahead, video_backend="pyav")
assert np.array_equal(window[0]["action"].numpy(), scene.actions(0)[:2])
assert next(iter(DataLoader(dataset, batch_size=4)))["observation.images.front"].shape == (4, 3, 24, 32)

exported = LeRobotDataset("freerein/compat", root=root / "exported", video_backend="pyav")
assert len(exported) == len(dataset)
for feature in ("observation.images.front", "observation.images.wrist", "action", "observation.state"):
    assert all(torch.equal(exported[row][feature], dataset[row][feature]) for row in (0, len(dataset) - 1))

discrete = LeRobotDataset("freerein/compat", root=root / "discrete", video_backend="pyav")
assert [int(item["action"]) for item in discrete] == [int(choice) for choice in scene.choices(0)[:, 0]]

page = (Path(__file__).parents[2] / "docs" / "lerobot.md").read_text()
(block,) = (each for each in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S) if "import LeRobotDataset" in each)
(root / "var" / "datasets").mkdir(parents=True)
(root / "var" / "datasets" / "arm").symlink_to(root / "continuous")
os.chdir(root)
exec(block, {})
print(f"lerobot {version('lerobot')} opens a freerein dataset: {row} frames and actions equal")  # noqa: T201
