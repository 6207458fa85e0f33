"""Opens datasets with exported labels in the real LeRobot, where it reads them. Usage: open_exported.py ROOT."""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scene
from datasets import load_dataset
from lerobot.datasets.language_render import active_at
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.rewards.sarm.sarm_utils import find_stage_and_tau
from lerobot.utils.collate import lerobot_collate_fn
from torch.utils.data import DataLoader

for name in ("images", "video"):
    root = Path(sys.argv[1]) / name
    dataset = LeRobotDataset("freerein/compat", root=root, video_backend="pyav")
    stages = json.loads((root / "meta/temporal_proportions_dense.json").read_text())
    assert set(stages) == set(scene.SKILL_NAMES)
    assert dataset.meta.has_language_columns
    assert len(next(iter(DataLoader(dataset, batch_size=9, collate_fn=lerobot_collate_fn)))["action"]) == 9
    for row in range(dataset.num_frames):
        item = dataset[row]
        index, step = int(item["episode_index"]), int(item["frame_index"])
        label = scene.LABELS[index][step]
        active = active_at(float(item["timestamp"]), persistent=item["language_persistent"], style="subtask")
        expected = scene.SKILL_NAMES[label] if label >= 0 else ""
        assert (active["content"] if active else "") == expected
        assert np.array_equal(item["action"].numpy(), scene.actions(index)[step])
        if label >= 0:
            columns = (f"dense_subtask_{each}" for each in ("names", "start_frames", "end_frames"))
            annotated = [dataset.meta.episodes[each][index] for each in columns]
            stage, _ = find_stage_and_tau(step, scene.LENGTHS[index], *annotated, list(stages), stages)
            assert list(stages)[stage] == expected
    features = load_dataset("parquet", data_files=str(root / "data/chunk-000/file-000.parquet"), split="train").features
    assert "language_persistent" in features
print(f"lerobot {version('lerobot')} finds exported labels as subtasks and as stages of SARM")  # noqa: T201
