"""A dataset of a user's own robot: actions in any unit, a report of its fit, and true labels that no fit sees."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
import torch

from freerein.data import DatasetSpec, create, dataset_path, label
from freerein.learning import weights
from freerein.learning.action_scaling import ActionScaling
from freerein.types.common import ActionSpec, Camera, Trajectory
from freerein_segmentation.methods import METHODS
from freerein_segmentation.model import ModelSpec, SegmentationModel, SegmentationNetwork

SKILLS = ("push", "turn")
ACTION = ActionSpec(1, 0, ("v",))
Fitted: TypeAlias = tuple[SegmentationModel, dict[str, Any]]
Fit: TypeAlias = Callable[..., Fitted]
STEPS = {"steps": 60, "hidden_size": 8, "features": 8, "augmentation": 0.0, "lr": 1e-2, "validation_fraction": 0.3}


def record(data_dir: Path, *, scaled: bool) -> Path:
    """Records demonstrations that only actions tell apart: of 900 or 500 ticks, or of 0.9 and 0.5."""
    root, rng = dataset_path(data_dir, "demos"), np.random.default_rng(0)
    spec = DatasetSpec(10, {"top": (8, 8, 3)}, ACTION, "toy", SKILLS, has_scaled_actions=scaled)
    with create(root, spec) as writer:
        for index in range(40):
            skills = [(0,), (1,), (0, 1), (1, 0)][index % 4]
            speeds = np.repeat(np.array([0.9, 0.5])[list(skills)], 4)[:, None] + rng.normal(
                0, 0.02, (4 * len(skills), 1)
            )
            frames = {"top": np.zeros((len(speeds), 8, 8, 3), np.uint8)}
            actions = (speeds * (1 if scaled else 1000)).astype(np.float32)
            writer.append(Trajectory(frames, actions, tuple(sorted({SKILLS[each] for each in skills}))))
    return root


@pytest.fixture(scope="session")
def fit(run_child: Callable[..., tuple[int, str]]) -> Fit:
    """Fits in a child process, into a folder; returns the model and its card."""

    def run(data_dir: Path, folder: Path, **changes: Any) -> Fitted:
        folder.mkdir()
        config = METHODS.resolve(data_dir, "demos", {**STEPS, **changes}, threads=1)
        (folder / "config.json").write_text(json.dumps({"dataset": "demos", "config": config, "steps": STEPS["steps"]}))
        assert run_child("freerein_segmentation.fit_child", folder, data_dir, "cpu")[0] == 0
        return METHODS.load(folder / "model", "cpu"), json.loads((folder / "model" / "card.json").read_text())

    return run


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory, fit: Fit) -> Fitted:
    """A fit to actions in a unit of their own."""
    folder = tmp_path_factory.mktemp("data")
    record(folder, scaled=False)
    return fit(folder, folder / "fit")


def test_actions_in_a_unit_of_their_own_are_learned_from_and_asked_about_in_it(fitted: Fitted) -> None:
    model, card = fitted
    scaling = card["spec"]["action_scaling"]
    assert 400 < scaling["low"][0] < 550 < 850 < scaling["high"][0] < 1000
    assert model.action is not None
    assert model.action.bounds[1] > 1e38
    for skill, ticks in zip(SKILLS, (900, 500), strict=True):
        likely = model.predict(np.zeros((4, 8, 8, 3), np.uint8), np.full((4, 1), ticks, np.float32)).probabilities
        assert [SKILLS[each] for each in likely.argmax(axis=1)] == [skill] * 4


def test_a_model_asked_in_a_unit_of_its_own_equals_one_asked_in_scaled_actions() -> None:
    spec = ModelSpec(cameras=(Camera("top", 8, 8, 3),), action=ACTION, skills=SKILLS, hidden_size=8, features=8)
    scaling = ActionScaling((-300.0,), (900.0,))
    own, plain = (SegmentationNetwork(replace(spec, action_scaling=each)) for each in (scaling, None))
    weights.initialise(own, generator=torch.Generator().manual_seed(0))
    seen = np.random.default_rng(0).integers(0, 256, (6, 8, 8, 3), np.uint8)
    own.image.fit_normalisation({"top": torch.from_numpy(seen)}, generator=torch.Generator())
    plain.load_state_dict(own.state_dict())
    ticks = np.linspace(-300, 900, 6, dtype=np.float32)[:, None]
    answers = [
        SegmentationModel(own).predict(seen, ticks).probabilities,
        SegmentationModel(plain).predict(seen, (ticks - 300) / 600).probabilities,
    ]
    still = SegmentationModel(own).predict(seen, np.zeros_like(ticks)).probabilities
    np.testing.assert_allclose(*answers, atol=1e-6, equal_nan=False)
    assert np.abs(answers[0] - still).max() > 1e-3  # the actions count


def test_the_card_says_how_well_tags_of_held_out_trajectories_are_told(fitted: Fitted) -> None:
    model, card = fitted
    assert (model.fps, card["data"]["fps"]) == (10, 10)
    each = card["tag_average_precision"]
    assert (card["held_out"], set(each)) == (12, set(SKILLS))
    assert all(0 < figures["chance"] < 1 and figures["average_precision"] > 0.9 for figures in each.values())
    mean = np.mean([figures["average_precision"] for figures in each.values()])
    assert card["figures"]["tag_average_precision"] == pytest.approx(mean)


def test_a_fit_warns_where_only_the_last_frame_tells_the_tags(fitted: Fitted, fit: Fit, tmp_path: Path) -> None:
    spec = DatasetSpec(10, {"top": (8, 8, 3)}, ACTION, "toy", SKILLS)
    with create(dataset_path(tmp_path, "demos"), spec) as writer:
        for index in range(40):
            shown = [(True, False), (False, True), (True, True)][index % 3]
            frames = np.zeros((8, 8, 8, 3), np.uint8)
            frames[-1] = 255 * np.repeat(shown, 4)[None, :, None]
            tags = tuple(skill for skill, is_shown in zip(SKILLS, shown, strict=True) if is_shown)
            writer.append(Trajectory({"top": frames}, np.zeros((8, 1), np.float32), tags))
    _, card = fit(tmp_path, tmp_path / "fit", final_objective="self_training")
    assert card["figures"]["tag_average_precision"] > 0.9
    assert any("context=5" in each for each in card["warnings"])
    assert [each.split(":")[0] for each in fitted[1]["warnings"]] == ["`in_distribution` could not be calibrated"]


def test_a_fit_is_the_same_to_the_bit_whatever_its_true_labels_say(fit: Fit, tmp_path: Path) -> None:
    root = record(tmp_path, scaled=True)
    _, without = fit(tmp_path, tmp_path / "without", steps=10)
    wrong = b"trajectory,start,end,skill\n2,0,4,turn\n2,4,8,push\n3,0,4,push\n3,4,8,turn\n"
    assert label(root, wrong) == 2
    _, labelled = fit(tmp_path, tmp_path / "labelled", steps=10)
    weights = [(tmp_path / name / "model/model.safetensors").read_bytes() for name in ("without", "labelled")]
    assert weights[0] == weights[1]
    assert without == labelled
    assert without["spec"]["action_scaling"] is None  # actions of ours are in [-1, 1] already
