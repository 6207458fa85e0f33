"""`freerein segment --save` and `freerein act`, with the real services around the models of the fault tests."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app
from freerein.data import DatasetSpec, create, labels
from freerein.errors import FailedPrecondition
from freerein.types.common import ActionSpec, Trajectory

pytestmark = pytest.mark.e2e
FAULTS = Path(__file__).parents[1] / "faults"
_SPEC = DatasetSpec(fps=10, cameras={"top": (4, 4, 3)}, action=ActionSpec(2, 0, ("x", "y")), robot_type="arm")


@pytest.fixture(scope="module")
def addresses(start_module_service: Callable[..., Any]) -> dict[str, str]:
    modules = {"SEGMENTATION": "tests.faults.faulty_service", "IMITATION": "tests.faults.faulty_policy"}
    services = {name: start_module_service(module, FREEREIN_SHIPPED_DIR="none") for name, module in modules.items()}
    return {f"FREEREIN_{name}_ADDRESS": service.address for name, service in services.items()}


@pytest.fixture
def data_dir(addresses: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for variable, value in {**addresses, "FREEREIN_DATA_DIR": str(tmp_path)}.items():
        monkeypatch.setenv(variable, value)
    return tmp_path


def record(root: Path, *brightness: list[int], fault: int = 0) -> None:
    """Writes a dataset with a trajectory for each list of brightness, whose parity is the label."""
    with create(root, _SPEC) as writer:
        for values in brightness:
            frames = np.zeros((len(values), 4, 4, 3), np.uint8)
            frames[:, 0, 0, 2] = values
            frames[0, 0, 0, 0] = fault
            writer.append(Trajectory({"top": frames}, np.zeros((len(values), 2), np.float32)))


def record_cameras(root: Path, **brightness: int) -> None:
    """Writes a dataset with a trajectory of three timesteps, whose cameras differ in brightness."""
    spec = replace(_SPEC, cameras=dict.fromkeys(brightness, (4, 4, 3)))
    with create(root, spec) as writer:
        frames = {camera: np.zeros((3, 4, 4, 3), np.uint8) for camera in brightness}
        for camera, value in brightness.items():
            frames[camera][..., 2] = value
        writer.append(Trajectory(frames, np.zeros((3, 2), np.float32)))


def _run(*words: str) -> Result:
    return CliRunner().invoke(app, [*words, "--json"])


def test_a_whole_dataset_is_labelled_and_the_labels_stay_beside_it(data_dir: Path) -> None:
    root = data_dir / "datasets" / "demos"
    record(root, [0, 1, 1], [3, 2])

    document = json.loads(_run("segment", "demos", "--save").stdout)

    assert (document["labelled"], document["skills"]) == (2, ["even", "odd"])
    assert [found.tolist() for found in labels.all_labels(root, np.array([3, 2]))] == [[0, 1, 1], [1, 0]]
    assert labels.info(root).model.version == document["model"]["version"]
    assert document["path"] == str(root / "labels")
    said = CliRunner().invoke(app, ["segment", "demos", "--save"]).stdout
    assert f"The labels are in {root / 'labels'}; freerein dataset export demos" in said


def test_the_frames_are_of_the_camera_that_the_model_was_fitted_on(data_dir: Path) -> None:
    root = data_dir / "datasets" / "two"
    record_cameras(root, above=0, front=1)

    answer = json.loads(_run("segment", "two").stdout)
    _run("segment", "two", "--save")

    assert (answer["labels"], answer["flagged"]) == ([1, 1, 1], 0)
    assert [found.tolist() for found in labels.all_labels(root, np.array([3]))] == [[1, 1, 1]]


@pytest.mark.parametrize("words", [["--save"], ["--index", "0"], ["--camera", "front"]])
def test_a_dataset_of_several_other_cameras_is_refused(data_dir: Path, words: list[str]) -> None:
    record_cameras(data_dir / "datasets" / "others", above=0, side=1)

    error = json.loads(_run("segment", "others", *words).stderr)["error"]

    assert (error["code"], error["field"]) == ("invalid_input", "camera")
    assert "above, side" in error["detail"]


def test_short_segments_are_rejected_in_a_dataset(data_dir: Path) -> None:
    root = data_dir / "datasets" / "rejected"
    record(root, [0, 1, 1], [3, 2])

    _run("segment", "rejected", "--save", "--min-kept", "2")

    assert [found.tolist() for found in labels.all_labels(root, np.array([3, 2]))] == [[-1, 1, 1], [-1, -1]]


def test_labels_that_could_not_all_be_made_do_not_count(data_dir: Path) -> None:
    root = data_dir / "datasets" / "broken"
    record(root, [0, 1], fault=2)

    result = _run("segment", "broken", "--save")

    assert json.loads(result.stderr)["error"]["code"] == "output_not_finite"
    with pytest.raises(FailedPrecondition):
        labels.info(root)


def test_a_policy_is_asked_once_and_says_what_it_wants_to_see(data_dir: Path) -> None:
    for name, colour in (("now", (0, 0, 9)), ("near", (0, 0, 9)), ("far", (0, 0, 200))):
        PIL.Image.new("RGB", (4, 4), colour).save(data_dir / f"{name}.png")
    now, near, far = (str(data_dir / f"{name}.png") for name in ("now", "near", "far"))

    spec = json.loads(_run("act", "spec").stdout)
    answers = [json.loads(_run("act", "--image", now, "--goal", goal).stdout) for goal in (far, near)]

    assert (spec["goal_form"], spec["cameras"][0]["name"]) == ("images", "front")
    assert answers[0]["actions"]["shape"] == [spec["horizon"], spec["action"]["size"]]
    assert [answer["goal_reached"] for answer in answers] == [False, True]
    table = CliRunner().invoke(app, ["act", "--image", f"front={now}", "--goal", far]).stdout
    assert "pursuing goal 0; confidence" in table
    refused = json.loads(_run("act", "--image", now, "--goal-text", "wave").stderr)
    assert (refused["error"]["code"], refused["error"]["field"]) == ("invalid_input", "goal.images")
    with_state = json.loads(_run("act", "--image", now, "--goal", far, "--robot-state=-0.5,12").stdout)
    assert with_state["actions"] == answers[0]["actions"]
    refused = json.loads(_run("act", "--image", now, "--goal", far, "--robot-state", "up").stderr)
    assert (refused["error"]["code"], refused["error"]["field"]) == ("invalid_input", "robot_state")
    PIL.Image.new("RGB", (12, 8), (0, 0, 9)).save(data_dir / "large.png")
    asked = ["act", "--image", str(data_dir / "large.png"), "--goal", far]
    assert "resize" in json.loads(_run(*asked).stderr)["error"]["hint"]
    assert json.loads(_run(*asked, "--resize", "crop").stdout)["resized"]


@pytest.mark.parametrize(
    "words",
    [
        ["--goal", "x.png"],
        ["--image", "x.png"],
        ["--image", "x", "--goal", "x", "--recipe", "a"],
        ["--image", "x", "--recipe", "a", "--goal-text", "wave"],
    ],
)
def test_what_cannot_be_acted_on_is_an_error(data_dir: Path, words: list[str]) -> None:
    result = _run("act", *words)

    assert result.exit_code == 1
    assert json.loads(result.stderr)["error"]["code"] == "invalid_input"
