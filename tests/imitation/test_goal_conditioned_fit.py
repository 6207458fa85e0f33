from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.data import DatasetSpec, create, dataset_path, labels
from freerein.data.labels import LabelsInfo
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_imitation import fit, model

TINY = {"steps": 2, "batch_size": 2, "features": 8, "hidden_size": 8, "embedding_size": 4}
ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with a dataset of exploration, seen by two cameras."""
    rng = np.random.default_rng(0)
    cameras = {"front": (12, 12, 3), "left": (12, 12, 3)}
    spec = DatasetSpec(fps=25, cameras=cameras, action=ACTION, robot_type="test")
    with create(dataset_path(tmp_path, "play"), spec) as writer:
        for _ in range(4):
            frames = {camera: rng.integers(0, 256, (24, *size), np.uint8) for camera, size in cameras.items()}
            writer.append(Trajectory(frames, rng.uniform(-1, 1, (24, 2)).astype(np.float32)), None)
    return tmp_path


def test_a_fit_leaves_a_policy_that_knows_what_its_actions_mean(data_dir: Path, run_fit: Any) -> None:
    policy = model.load(run_fit(data_dir, "play", {"camera": "front", **TINY}), "cpu")
    assert (policy.spec.goal_form, policy.spec.camera, policy.spec.action) == ("images", "front", ACTION)
    assert (policy.spec.control_dt_s, policy.spec.max_steps_per_goal) == (0.04, 30)


def test_frames_that_no_policy_is_made_for_are_refused_before_a_fit_begins(data_dir: Path) -> None:
    spec = DatasetSpec(fps=25, cameras={"front": (8, 1280, 3)}, action=ACTION, robot_type="test")
    root = dataset_path(data_dir, "wide")
    with create(root, spec) as writer:
        writer.append(Trajectory({"front": np.zeros((2, 8, 1280, 3), np.uint8)}, np.zeros((2, 2), np.float32)), None)
    labels.save(root, 0, np.zeros(2, np.int64))
    labels.finish(root, LabelsInfo(("pick", "push"), ModelRef("segments", "0123456789ab")))
    for policy in ("goal_conditioned", "skills"):
        with pytest.raises(InvalidInput, match=r"`width` must be in .4, 1024.; got 1280"):
            fit.resolve(data_dir, "wide", {"policy": policy}, threads=1)


def test_a_fit_is_asked_for_precisely(data_dir: Path) -> None:
    assert fit.resolve(data_dir, "play", {"camera": "left"}, threads=3)["threads"] == 3
    for wrong in ({}, {"camera": "right"}, {"camera": "left", "policy": "pilot"}, {"camera": "left", "tags": True}):
        with pytest.raises(InvalidInput):
            fit.resolve(data_dir, "play", wrong, threads=1)


@pytest.mark.parametrize("policy", [["skills"], {}, None, 1, "pilot"])
def test_a_kind_of_policy_that_there_is_not_is_refused_by_name(data_dir: Path, policy: object) -> None:
    with pytest.raises(InvalidInput) as error:
        fit.resolve(data_dir, "play", {"camera": "left", "policy": policy}, threads=1)
    assert error.value.field == "config.policy"
