"""Fits with stages that are stopped between two optimiser steps and resumed; one loop fits all methods."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.config import parse
from freerein.data import DatasetSpec, create, dataset_path
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.learning import weights
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.training_loop import fit
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_imitation.methods import METHODS

TINY = {
    "batch_size": 2,
    "steps": 12,
    "evaluate_every": 4,
    "checkpoint_every": 5,
    "log_every": 3,
}
SMALL_ENCODER = {"encoder": "patch", "features": 8, "hidden_size": 8}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> FitDataset:
    """A labelled dataset of noise."""
    data_dir, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    action = ActionSpec(1, 0, ("right",))
    root = dataset_path(data_dir, "noise")
    spec = DatasetSpec(fps=10, cameras={"front": (8, 8, 1)}, action=action, robot_type="test", skills=("pick", "push"))
    with create(root, spec) as writer:
        for _ in range(6):
            frames = {"front": rng.integers(0, 256, (20, 8, 8, 1), np.uint8)}
            writer.append(Trajectory(frames, rng.uniform(-1, 1, (20, 1)).astype(np.float32), ("pick", "push")))
    with LabelsWriter(root, name="test") as writer:
        for index in range(6):
            writer.save(index, np.repeat([1, 0], [8, 12]))
        writer.finish(LabelsInfo(("pick", "push"), ModelRef("segments", "0123456789ab")))
    return FitDataset.open(data_dir, "noise")


STAGES = {"forward_consistency_weight": 0.1, "forward_pretraining_steps": 3, "policy_pretraining_steps": 4}


@pytest.mark.parametrize(
    ("method", "change"),
    [
        ("goal_conditioned", SMALL_ENCODER | STAGES),  # which is stopped in the second
        ("skills", {"steps": 18, "evaluate_every": 9, "hidden_size": 8}),
    ],
)
def test_a_fit_that_is_stopped_goes_on_to_the_same_bits_and_another_seed_gives_others(
    method: str, change: dict[str, Any], source: FitDataset, tmp_path: Path
) -> None:
    def run(folder: Path, stop: Callable[[], bool] = lambda: False, seed: int = 0) -> str:
        """Fits with a learner of its own; returns the sha256 of the best weights, calibrated."""
        chosen = METHODS.by_name[method]
        config = parse(chosen.config, {**TINY, **change, "cameras": ("front",), "seed": seed})
        learner = chosen.prepare(source, config, torch.device("cpu"))
        fitted = fit(learner, folder, stop=stop)
        if fitted is None:
            return ""
        learner.calibrate(fitted.network)
        assert fitted.network.in_distribution.distances.any()
        return weights.sha256(fitted.network) + (folder / "metrics.jsonl").read_text()

    whole = run(tmp_path / "whole")
    assert run(tmp_path / "other", seed=1)[:64] != whole[:64]
    asked = iter(range(6))
    assert run(tmp_path / "cut", stop=lambda: next(asked) == 5) == ""
    assert run(tmp_path / "cut") == whole
