"""A user's own dataset becomes an endpoint: fitted, reported on and asked, with the real service."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import DatasetSpec, create
from freerein.data.lerobot_folder import export_lerobot
from freerein.types.common import ActionSpec, Trajectory

pytestmark = pytest.mark.e2e
TINY = ("steps=3", "augmentation=0", "hidden_size=8", "features=8", "validation_fraction=0.5")


def _json(*words: str) -> dict[str, Any]:
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0, result.output
    return dict(json.loads(result.stdout.splitlines()[-1]))


def test_a_fit_reports_tags_that_it_was_not_given_and_labels_that_it_never_sees(
    start_service: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = DatasetSpec(10, {"top": (8, 8, 3)}, ActionSpec(1, 0, ("v",)), "toy", has_scaled_actions=False)
    with create(tmp_path / "datasets" / "own", spec) as writer:
        for index in range(8):
            actions = np.full((4, 1), 500 + 400 * (index % 2), np.float32)
            writer.append(Trajectory({"top": np.full((4, 8, 8, 3), index, np.uint8)}, actions))
    tags, labels = tmp_path / "tags.csv", tmp_path / "labels.csv"
    tags.write_text("trajectory,skills\n" + "".join(f"{index},{('push', 'turn')[index % 2]}\n" for index in range(8)))
    labels.write_text("trajectory,start,end,skill\n0,0,4,push\n1,0,3,turn\n")
    service = start_service("freerein_segmentation", tmp_path, FREEREIN_SHIPPED_DIR="none")
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("FREEREIN_SEGMENTATION_ADDRESS", service.address)
    _json("dataset", "tag", "own", str(tags))
    _json("dataset", "label", "own", str(labels))

    fit = _json("fit", "segmentation", "own", *(word for each in TINY for word in ("--set", each)), "--watch")
    report = _json("jobs", "report", fit["id"])
    segments = _json("segment", "own", "--index", "0")

    assert (report["held_out"], report["labelled"]["trajectories"], report["labelled"]["timesteps"]) == (4, 2, 7)
    assert 0 <= report["labelled"]["frame_accuracy"] <= report["labelled"]["random_cls_accuracy"] == 1
    assert set(report["tag_average_precision"]) <= {"push", "turn"}
    assert any("10 or more trajectories" in each for each in report["warnings"])
    assert [set(segments["skills"]), len(segments["labels"])] == [{"push", "turn"}, 4]
    model = fit["model"]
    assert "must not be active" in CliRunner().invoke(app, ["models", "rm", model["name"]]).stderr
    assert _json("models", "rm", model["name"], model["version"], "--active") == {"service": "segmentation", **model}
    assert _json("fit", "rm", fit["id"][:8]) == {"fit": fit["id"], "deleted": True}
    assert not list((tmp_path / "fits" / "segmentation").glob("[0-9a-f]*"))
    missing = CliRunner().invoke(app, ["fit", "report", "0" * 32, "--json"])
    assert json.loads(missing.stderr)["error"]["code"] == "not_found"


def test_a_lerobot_dataset_of_exploration_becomes_policy_and_endpoint_by_one_command(
    start_service: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, spec = np.random.default_rng(0), DatasetSpec(10, {"top": (12, 12, 3)}, ActionSpec(2, 0, ("x", "y")), "toy")
    with create(tmp_path / "made", spec) as writer:
        for _ in range(4):
            frames = rng.integers(0, 256, (20, 12, 12, 3), np.uint8)
            writer.append(Trajectory({"top": frames}, rng.uniform(-1, 1, (20, 2)).astype(np.float32)))
    export_lerobot(tmp_path / "made", tmp_path / "play")
    service = start_service("freerein_imitation", tmp_path, FREEREIN_SHIPPED_DIR="none")
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("FREEREIN_IMITATION_ADDRESS", service.address)

    refused = CliRunner().invoke(app, ["fit", "imitation", "--recordings", str(tmp_path / "play"), "--set", "x=1"])
    assert refused.exit_code == 1
    assert not (tmp_path / "datasets" / "play").exists()
    settings = ("steps=3", "features=8", "hidden_size=8", "validation_fraction=0.5")
    given = [word for each in settings for word in ("--set", each)]
    fit = _json("fit", "imitation", "--recordings", str(tmp_path / "play"), *given, "--watch")

    assert (fit["dataset"], fit["state"]) == ("play", "succeeded")
    for name in ("now", "goal"):
        PIL.Image.fromarray(rng.integers(0, 256, (12, 12, 3), np.uint8)).save(tmp_path / f"{name}.png")
    answer = _json("act", "--image", str(tmp_path / "now.png"), "--goal", str(tmp_path / "goal.png"))
    assert answer["model"] == fit["model"]
    assert 0 <= answer["goal_confidence"] <= 1
