import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.data import DatasetSpec, create, dataset_path
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.errors import InvalidInput
from freerein.learning.encoders import MomentsEncoder
from freerein.learning.fit_dataset import FitDataset
from freerein.types.common import ActionSpec, Camera, ModelRef, Trajectory
from freerein_imitation.methods import METHODS

TINY = {"steps": 2, "batch_size": 2, "features": 8, "hidden_size": 8, "embedding_size": 4}
LEFT: dict[str, Any] = {"cameras": ["left"]}
ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with a dataset of exploration, seen by two cameras."""
    rng = np.random.default_rng(0)
    cameras = {"front": (12, 12, 3), "left": (10, 14, 1)}
    spec = DatasetSpec(fps=25, cameras=cameras, action=ACTION, robot_type="test")
    with create(dataset_path(tmp_path, "play"), spec) as writer:
        for _ in range(4):
            frames = {camera: rng.integers(0, 256, (24, *size), np.uint8) for camera, size in cameras.items()}
            writer.append(Trajectory(frames, rng.uniform(-1, 1, (24, 2)).astype(np.float32)), None)
    return tmp_path


def test_a_fit_leaves_a_policy_that_knows_what_its_actions_mean(data_dir: Path, run_fit: Any) -> None:
    folder = run_fit(data_dir, "play", TINY)
    policy = METHODS.load(folder, "cpu")
    note = "Of the cameras front, left, the model sees front; another is chosen by --set cameras=left."
    assert json.loads((folder / "card.json").read_text())["notes"] == [note]
    assert (policy.spec.goal_form, policy.spec.action) == ("images", ACTION)
    assert policy.spec.cameras == (Camera("front", 12, 12, 3),)
    assert (policy.spec.control_dt_s, policy.spec.max_steps_per_goal) == (0.04, 30)


@pytest.mark.fault("O3")
def test_the_log_of_a_fit_tells_what_was_passed_over(data_dir: Path, run_fit: Any, run_child: Any) -> None:
    folder = run_fit(data_dir, "play", {**TINY, "checkpoint_every": 1}).parent
    (folder / "checkpoints" / "step-000000002" / "state.json").write_bytes(b"{")
    (folder / "checkpoints" / "step-000000001" / "state.json").write_bytes(b"{")
    shutil.rmtree(folder / "model")
    code, log = run_child("freerein_imitation.fit_child", folder, data_dir, "cpu")
    told = [line.partition(" A ")[0] for line in log.splitlines() if "passed over" in line]
    assert (code, told) == (0, [f"The checkpoint of step {step} is passed over." for step in (2, 1)])


def test_a_policy_learns_from_all_cameras_that_are_asked_for(data_dir: Path, run_fit: Any) -> None:
    folder = run_fit(data_dir, "play", {"cameras": ["left", "front"], "encoder": "convolutional", **TINY})
    policy = METHODS.load(folder, "cpu")
    assert policy.spec.cameras == (Camera("left", 10, 14, 1), Camera("front", 12, 12, 3))
    frames = {
        camera.name: np.zeros((2, camera.height, camera.width, camera.channels), np.uint8)
        for camera in policy.spec.cameras
    }
    goals, recurrent = policy.encode_goals(frames), np.zeros((2, policy.spec.recurrent_size), np.float32)
    before = policy.step(frames, goals, np.zeros((2, 2), np.float32), recurrent)
    frames["left"] = frames["left"] + np.uint8(200)
    after = policy.step(frames, goals, np.zeros((2, 2), np.float32), recurrent)
    assert not np.allclose(before.actions, after.actions)
    assert not np.allclose(before.reached, after.reached)
    card = json.loads((folder / "card.json").read_text())
    assert (card["method"], card["config"]["cameras"], card["notes"]) == ("goal_conditioned", ["left", "front"], [])


def test_frames_that_no_policy_is_made_for_are_refused_before_a_fit_begins(data_dir: Path) -> None:
    spec = DatasetSpec(fps=25, cameras={"front": (8, 1280, 3)}, action=ACTION, robot_type="test")
    root = dataset_path(data_dir, "wide")
    with create(root, spec) as writer:
        writer.append(Trajectory({"front": np.zeros((2, 8, 1280, 3), np.uint8)}, np.zeros((2, 2), np.float32)), None)
    with LabelsWriter(root, name="test") as labeller:
        labeller.save(0, np.zeros(2, np.int64))
        labeller.finish(LabelsInfo(("pick", "push"), ModelRef("segments", "0123456789ab")))
    for method in ("goal_conditioned", "skills"):
        with pytest.raises(InvalidInput, match=r"4 to 1024 pixels high and wide.*; got 8 x 1280 x 3"):
            METHODS.resolve(data_dir, "wide", {"method": method}, threads=1)


@pytest.mark.parametrize("method", ["goal_conditioned", "inverse_model"])
def test_an_embedding_too_small_for_one_heat_map_is_refused_before_a_fit_begins(data_dir: Path, method: str) -> None:
    least = MomentsEncoder.min_features
    asked = LEFT | {"method": method, "encoder": "moments", "embedding_size": least}
    assert METHODS.resolve(data_dir, "play", asked, threads=1)["embedding_size"] == least
    with pytest.raises(InvalidInput, match="at least 5 with the encoder moments; got 4") as error:
        METHODS.resolve(data_dir, "play", asked | {"embedding_size": least - 1}, threads=1)
    assert error.value.field == "config.embedding_size"


def test_a_fit_is_asked_for_precisely(data_dir: Path) -> None:
    assert METHODS.resolve(data_dir, "play", LEFT, threads=3)["threads"] == 3
    for wrong in ({"cameras": "right"}, LEFT | {"method": "pilot"}, LEFT | {"tags": True}):
        with pytest.raises(InvalidInput):
            METHODS.resolve(data_dir, "play", wrong, threads=1)


@pytest.mark.parametrize("method", [["skills"], {}, None, 1, "pilot"])
def test_a_method_that_there_is_not_is_refused_by_name(data_dir: Path, method: object) -> None:
    with pytest.raises(InvalidInput) as error:
        METHODS.resolve(data_dir, "play", LEFT | {"method": method}, threads=1)
    assert error.value.field == "config.method"


def test_a_policy_has_the_exact_control_period_and_the_choice_that_holds(data_dir: Path, run_fit: Any) -> None:
    action = ActionSpec(1, 4, ("no-op", "forward", "left", "right"), hold=0)
    spec = DatasetSpec(9, {"front": (12, 12, 1)}, action, "test", has_terminations=True, control_dt_s=4 / 35)
    with create(dataset_path(data_dir, "walk"), spec) as writer:
        for ends in (False, True):
            frames, walked = np.zeros((24, 12, 12, 1), np.uint8), np.ones((24, 1), np.int64)
            writer.append(Trajectory({"front": frames}, walked, terminated=np.arange(24) == (23 if ends else -1)))
    policy = METHODS.load(run_fit(data_dir, "walk", TINY), "cpu")
    assert policy.spec.control_dt_s == pytest.approx(4 / 35, rel=1e-12)
    assert policy.spec.action == action
    seen = FitDataset.open(data_dir, "walk").trajectories(["front"])
    assert [each.sum() for each in seen.terminated] == [0, 1]
