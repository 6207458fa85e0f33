import json
import os
import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.data import DatasetSpec, FitPrediction, check, create, dataset_path, predict_fit, tag
from freerein.data.batch_memory import DEFAULT_BATCH_SIZE, DEFAULT_STEPS, Batches, batch_problems
from freerein.data.layout import SPEC_FILE
from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.types.common import ActionSpec, Trajectory
from freerein_segmentation.methods import METHODS, _prepare
from freerein_segmentation.training import SegmentationConfig

ACTION = ActionSpec(2, 0, ("dy", "dz"), "m", (0.05, 0.05))


def record(
    data_dir: Path,
    name: str,
    *,
    length: int = 3,
    size: tuple[int, int] = (8, 12),
    action: ActionSpec = ACTION,
    cameras: tuple[str, ...] = ("front",),
    count: int = 2,
) -> Path:
    """Records demonstrations of two skills; returns the dataset's folder."""
    root = dataset_path(data_dir, name)
    sizes = dict.fromkeys(cameras, (*size, 3))
    spec = DatasetSpec(fps=25, cameras=sizes, action=action, robot_type="test", skills=("pick", "push"))
    with create(root, spec) as writer:
        for _ in range(count):
            frames = {camera: np.zeros((length, *size, 3), np.uint8) for camera in cameras}
            writer.append(Trajectory(frames, np.zeros((length, action.size), np.float32), ("pick", "push")))
    return root


def test_a_configuration_names_the_only_camera_and_every_default(tmp_path: Path) -> None:
    record(tmp_path, "demos")
    config = METHODS.resolve(tmp_path, "demos", {"steps": 3}, threads=2)
    assert [config[key] for key in ("method", "cameras", "steps", "threads")] == ["set_supervised", ("front",), 3, 2]


@pytest.mark.parametrize(
    ("asked", "seen"), [({}, "front"), ({"cameras": "wrist"}, "wrist"), ({"cameras": []}, "front")]
)
def test_of_several_cameras_the_first_is_seen_or_the_one_that_is_named(
    tmp_path: Path, asked: dict[str, Any], seen: str
) -> None:
    record(tmp_path, "demos", cameras=("front", "wrist"))
    assert METHODS.resolve(tmp_path, "demos", asked, threads=1)["cameras"] == (seen,)
    with pytest.raises(InvalidInput, match=r"among the dataset's, front, wrist, each once") as refused:
        METHODS.resolve(tmp_path, "demos", {"cameras": "top"}, threads=1)
    assert refused.value.hint == "For example: --set cameras=front."


@pytest.mark.fault("F16")
def test_a_pipe_in_a_dataset_is_refused_before_a_fit_begins(tmp_path: Path) -> None:
    data = record(tmp_path, "demos") / "data" / "chunk-000" / "file-001.parquet"
    data.unlink()
    os.mkfifo(data)
    with pytest.raises(InvalidInput, match="`Trajectory 1` must be a regular file; it is a pipe"):
        METHODS.resolve(tmp_path, "demos", {}, threads=1)


def test_frames_that_no_network_is_made_for_are_refused_before_a_fit_begins(tmp_path: Path) -> None:
    record(tmp_path, "wide", size=(8, 1280))
    with pytest.raises(InvalidInput, match=r"4 to 1024 pixels high and wide.*got 8 x 1280") as error:
        METHODS.resolve(tmp_path, "wide", {}, threads=1)
    assert error.value.hint == "Record larger frames, or store them as gray or RGB."


def test_a_batch_that_takes_too_much_memory_is_refused_by_check_and_fit_with_what_works(tmp_path: Path) -> None:
    """A batch of both trajectories has 145 million numbers, of which a fit holds several copies."""
    root = record(tmp_path, "large", length=23, size=(1024, 1024))
    (error,) = (each for each in check(root) if each.where == "frames")
    with pytest.raises(InvalidInput, match="have 145 million") as refused:
        METHODS.resolve(tmp_path, "large", {}, threads=1)
    assert (error.severity, error.sentence, error.hint) == ("error", refused.value.detail, refused.value.hint)
    assert error.hint == (
        "Import smaller frames: `freerein dataset import FOLDER large --replace --size 96x96`. "
        "Or smaller batches: `freerein fit segmentation large --set batch_size=1`."
    )
    assert METHODS.resolve(tmp_path, "large", {"batch_size": 1}, threads=1)
    assert METHODS.resolve(tmp_path, "large", {"stride": 2}, threads=1)
    with pytest.raises(InvalidInput):
        METHODS.resolve(tmp_path, "large", {"batch_size": 1, "encoder": "convolutional"}, threads=1)


@pytest.mark.parametrize(
    ("length", "frame", "proposed"),
    [
        (60, (480, 640, 3), ["--size 96x128", "--set batch_size=2"]),
        (60, (1080, 1920, 3), ["--size 96x171"]),
        (300, (640, 480, 1), ["--size 128x96", "--set batch_size=1"]),
        (900, (480, 640, 3), ["--size 64x85"]),
        (5000, (480, 640, 3), ["--size 48x64", "--set stride=3"]),
        (9000, (48, 64, 3), ["--set stride=5", "--set batch_size=1"]),
    ],
)
def test_what_a_refusal_proposes_is_held(length: int, frame: tuple[int, int, int], proposed: list[str]) -> None:
    batches = Batches(np.full(9, length), frame)
    (problem,) = batch_problems(batches, dataset="arm")
    assert re.findall(r"--s\w+ [\w=]+", problem.hint) == proposed
    values = {option: [int(each) for each in re.findall(r"\d+", option)] for option in proposed}
    size = next((tuple(values[each]) for each in proposed if "size " in each), frame[:2])
    stride = next((values[each][0] for each in proposed if "stride" in each), 1)
    assert replace(batches, frame=(*size, frame[2]), stride=stride).are_held
    assert all(replace(batches, size=values[each][0]).are_held for each in proposed if "batch_size" in each)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"size": (8, 1280)}, "4 to 1024 pixels high and wide"),
        ({"action": ActionSpec(257, 0, ())}, "at most 256 numbers"),
        ({"count": 1}, "at least 2 trajectories"),
    ],
)
def test_check_refuses_what_no_fit_takes(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    root = record(tmp_path, "odd", **changes)
    (error,) = (each for each in check(root) if each.severity == "error")
    assert sentence in error.sentence
    with pytest.raises(InvalidInput, match=re.escape(error.sentence)):
        _prepare(FitDataset.open(tmp_path, "odd"), SegmentationConfig(cameras=("front",)), torch.device("cpu"))


def test_check_predicts_the_fit_that_is_the_default(tmp_path: Path) -> None:
    root, config = record(tmp_path, "demos", cameras=("front", "wrist")), SegmentationConfig()
    assert (config.batch_size, config.steps, config.stride) == (DEFAULT_BATCH_SIZE, DEFAULT_STEPS, Batches.stride)
    minutes = pytest.approx(2000 * 6 * (80e-6 + 288 * 9e-9) / 60)
    assert predict_fit(root) == FitPrediction("front", (8, 12, 3), minutes, 6 * 288 * 30 / 1e9, 6 * 288 / 1e9)


def test_a_tag_that_is_no_skill_of_the_dataset_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path, "demos") / SPEC_FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "skills": ["pick"]}))
    with pytest.raises(InvalidInput, match="1 tags are not"):
        METHODS.resolve(tmp_path, "demos", {}, threads=1)


@pytest.mark.parametrize(
    "table", ["0,pick\n1,\n", "0,pick\n1,push\n", "0,pick;push\n1,pick;push\n", "0,pick\n1,pick\n"]
)
def test_a_fit_refuses_what_check_calls_an_error_and_takes_what_it_warns_of(tmp_path: Path, table: str) -> None:
    root = record(tmp_path, "demos")
    tag(root, f"trajectory,skills\n{table}".encode())
    problems = check(root)
    errors = [each.sentence for each in problems if each.severity == "error"]
    assert problems
    with pytest.raises(InvalidInput, match=re.escape(errors[0])) if errors else nullcontext():
        METHODS.resolve(tmp_path, "demos", {}, threads=1)


def test_evidence_of_actions_needs_actions(tmp_path: Path) -> None:
    record(tmp_path, "seen", action=ActionSpec(0, 0, ()))
    given = {"final_objective": "self_training", "action_evidence": 1.0}
    with pytest.raises(InvalidInput, match="`action_evidence` must be 0 for a dataset without actions"):
        METHODS.resolve(tmp_path, "seen", given, threads=1)
