"""Writes the scene with freerein. Usage: write_ours.py ROOT."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import scene

from freerein.data import DatasetSpec, create
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.data.lerobot_folder import export_lerobot
from freerein.types.common import ActionSpec, ModelRef, Trajectory

root = Path(sys.argv[1])
spec = DatasetSpec(
    fps=scene.FPS,
    cameras=scene.SIZES,
    action=ActionSpec(size=len(scene.ACTION_NAMES), choices=0, names=scene.ACTION_NAMES),
    robot_type="arm",
    skills=("pick", "place"),
    task=scene.TASK,
    has_terminations=True,
    robot_state_size=len(scene.STATE_NAMES),
    robot_state_names=scene.STATE_NAMES,
)
with create(root / "continuous", spec) as writer:
    for index, (skills, text) in enumerate(zip(scene.SKILLS, scene.GOAL_TEXTS, strict=True)):
        frames = {camera: scene.frames(index, camera) for camera in scene.SIZES}
        writer.append(
            Trajectory(
                frames=frames,
                actions=scene.actions(index),
                skills=skills,
                goal_text=text,
                terminated=scene.terminations(index),
            ),
            robot_state=scene.states(index),
        )
with LabelsWriter(root / "continuous", name="scene") as labeller:
    for index, length in enumerate(scene.LENGTHS):
        labeller.save(index, np.zeros(length, np.int64))
    labeller.finish(LabelsInfo(spec.skills, ModelRef("default", "0" * 12)))
export_lerobot(root / "continuous", root / "exported")

choice = ActionSpec(size=1, choices=scene.CHOICES, names=("left", "right", "forward"))
with create(
    root / "discrete", replace(spec, action=choice, has_terminations=False, robot_state_size=0, robot_state_names=())
) as writer:
    frames = {camera: scene.frames(0, camera) for camera in scene.SIZES}
    writer.append(Trajectory(frames=frames, actions=scene.choices(0)))
