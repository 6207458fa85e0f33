"""Labels LeRobot's datasets with freerein, and writes the labels into them. Usage: export_labels.py ROOT."""

import sys
from pathlib import Path

import numpy as np
import scene

from freerein.data import Dataset, LeRobotSource, import_trajectories
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.data.lerobot_export import export_labels
from freerein.types.common import ModelRef

for name in ("images", "video"):
    original, ours = Path(sys.argv[1]) / name, Path(sys.argv[1]) / f"labelled-{name}"
    import_trajectories(LeRobotSource(original, size=(12, 16)), ours)
    with LabelsWriter(ours, name="compat") as writer:
        for index in range(len(scene.LENGTHS)):
            writer.save(index, np.array(scene.LABELS[index]))
        writer.finish(LabelsInfo(scene.SKILL_NAMES, ModelRef("compat", "0")))
    export_labels(ours, original)
    assert Dataset(original).goal_texts == scene.TASKS
