import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.data import DatasetSpec, create, dataset_path
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.skills.policy import SkillsPolicy

ASKED = {"method": "skills", "steps": 2, "batch_size": 2, "hidden_size": 8}
ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with demonstrations that nobody has labelled."""
    rng = np.random.default_rng(0)
    spec = DatasetSpec(
        fps=25, cameras={"front": (12, 12, 3)}, action=ACTION, robot_type="test", skills=("pick", "push")
    )
    with create(dataset_path(tmp_path, "demos"), spec) as writer:
        for _ in range(4):
            frames = {"front": rng.integers(0, 256, (20, 12, 12, 3), np.uint8)}
            writer.append(Trajectory(frames, rng.uniform(-1, 1, (20, 2)).astype(np.float32), ("pick", "push")))
    return tmp_path


def label(data_dir: Path) -> None:
    root = dataset_path(data_dir, "demos")
    with LabelsWriter(root, name="test") as writer:
        for index in range(4):
            writer.save(index, np.repeat([1, 0], [8, 12]))
        writer.finish(LabelsInfo(("pick", "push"), ModelRef("segments", "0123456789ab")))


def test_demonstrations_must_be_labelled_before_skills_are_learned(data_dir: Path) -> None:
    with pytest.raises(FailedPrecondition, match="skill for every timestep"):
        METHODS.resolve(data_dir, "demos", ASKED, threads=1)
    label(data_dir)
    config = METHODS.resolve(data_dir, "demos", ASKED, threads=3)
    assert (config["method"], config["cameras"], config["threads"]) == ("skills", ("front",), 3)
    with pytest.raises(InvalidInput):
        METHODS.resolve(data_dir, "demos", {**ASKED, "truth": True}, threads=1)


def test_a_fit_leaves_skills_that_tell_whose_labels_they_are_from(data_dir: Path, run_fit: Any) -> None:
    label(data_dir)
    folder = run_fit(data_dir, "demos", ASKED)
    policy = METHODS.load(folder, "cpu")
    assert isinstance(policy, SkillsPolicy)
    assert (policy.spec.skills, policy.spec.action, policy.spec.max_steps_per_goal) == (("pick", "push"), ACTION, 18)
    card = json.loads((folder / "card.json").read_text())
    assert card["labels"]["model"] == {"name": "segments", "version": "0123456789ab"}
    warning, uncalibrated = card["warnings"]
    assert "`in_distribution` could not be calibrated" in uncalibrated
    assert "must have `gripper` in its name; got dy, dz." in warning
