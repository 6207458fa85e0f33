"""VICE: a fixed classifier of success, trained on a dataset, rewards a policy."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.data import DatasetSpec, create, dataset_path
from freerein.errors import InvalidInput, NotFound
from freerein.types.common import ActionSpec, Camera, ModelRef, Trajectory
from freerein_orchestrator.rewards.entry import RewardSetting
from freerein_orchestrator.rewards.vice import ViceReward
from freerein_orchestrator.rl.config import PPOConfig

CAMERA = Camera("top", 33, 30, 3)
CONFIG = {"reward": "vice", "dataset": "won", "encoder": "spatial", "iterations": 2, "num_envs": 2, "num_steps": 8}
SMALL = {"task": "grid", "epochs": 1, "batch_size": 8, "hidden_size": 8, "feature_size": 8}


def frames(rng: np.random.Generator, *, won: bool) -> Any:
    """Returns six frames, of which the last is bright on the left where the trajectory is won."""
    drawn = rng.integers(0, 100, (6, CAMERA.height, CAMERA.width, CAMERA.channels)).astype(np.uint8)
    drawn[-1, :, :15] = 220 if won else 50
    return drawn


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """A data directory with the dataset `won`."""
    rng, size = np.random.default_rng(0), (CAMERA.height, CAMERA.width, CAMERA.channels)
    spec = DatasetSpec(fps=5, cameras={CAMERA.name: size}, action=ActionSpec(0, 0, ()), robot_type="grid")
    with create(dataset_path(tmp_path, "won"), spec) as writer:
        for _ in range(8):
            writer.append(Trajectory({CAMERA.name: frames(rng, won=True)}, np.zeros((6, 0), np.float32)))
    return tmp_path


def reward(data_dir: Path, dataset: str = "won", camera: Camera = CAMERA) -> ViceReward:
    service: Any = None  # it needs none
    return ViceReward(RewardSetting(PPOConfig(), "", "", (camera,), ModelRef(), service, data_dir, dataset))


def test_frames_like_the_last_ones_of_the_dataset_earn_1_and_others_0(data_dir: Path) -> None:
    trained, restored, rng = reward(data_dir), reward(data_dir), np.random.default_rng(1)
    trained.begin()
    new = np.concatenate([frames(rng, won=won) for won in (True, False)])
    assert trained.of_frames({CAMERA.name: new}).tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    restored.restore(trained.snapshot())
    ours, theirs = trained.snapshot().tensors, restored.snapshot().tensors
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)


def test_examples_that_are_not_there_or_of_another_camera_are_refused(data_dir: Path) -> None:
    with pytest.raises(NotFound):
        reward(data_dir, "lost").begin()
    with pytest.raises(InvalidInput, match="camera front"):
        reward(data_dir, camera=Camera("front", 33, 30, 3)).begin()


@pytest.mark.e2e
def test_a_run_stopped_after_an_iteration_ends_with_the_bits_of_an_undisturbed_one(
    new_run: Callable[..., Any], mortal_sim: Any, data_dir: Path
) -> None:
    stopped, whole = (
        new_run(data_dir, "ppo", CONFIG | SMALL, FREEREIN_SIM_ADDRESS=mortal_sim.address) for _ in range(2)
    )
    assert not stopped.do(stop=lambda: bool(stopped.rows))
    (dataset_path(data_dir, "won")).rename(data_dir / "elsewhere")  # it is needed no longer
    assert stopped.do()
    (data_dir / "elsewhere").rename(dataset_path(data_dir, "won"))
    assert whole.do()
    card = whole.artifact("policy.json")
    assert stopped.artifact("policy.json") == card
    assert card["privileged"]
    assert "privileged" in card["supervision"]
    assert (whole.rows[-1]["privileged"], card["model"]) == (1.0, {"name": "", "version": ""})
