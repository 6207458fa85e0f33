"""`freerein reward` as a user types it, with the real service around toy models."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app
from freerein.data import Dataset, DatasetSpec, create
from freerein.ports import PORTS
from freerein.types.common import ActionSpec, Trajectory

pytestmark = pytest.mark.e2e
TOY = "tests.reward.toy_service"
GOAL = ("--goal", "more", "--rival", "less")


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service(TOY, FREEREIN_SHIPPED_DIR="none")


@pytest.fixture
def folder(service: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data directory with the dataset `demos`, and the folder `frames`: three moments that grow brighter."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("FREEREIN_REWARD_ADDRESS", service.address)
    brightness = np.array([10, 120, 250], np.uint8)
    frames = np.broadcast_to(brightness[:, None, None, None], (3, 4, 5, 3)).copy()
    spec = DatasetSpec(fps=10, cameras={"top": (4, 5, 3)}, action=ActionSpec(2, 0, ("x", "y")), robot_type="arm")
    with create(tmp_path / "datasets" / "demos", spec) as writer:
        writer.append(Trajectory({"top": frames}, np.zeros((3, 2), np.float32)))
    (tmp_path / "frames").mkdir()
    for moment, frame in enumerate(frames):
        PIL.Image.fromarray(frame).save(tmp_path / "frames" / f"{moment}.png")
    return tmp_path


def _run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def _json(*words: str) -> list[dict[str, Any]]:
    result = _run(*words, "--json")
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_files_a_folder_and_a_trajectory_get_the_same_rewards(folder: Path) -> None:
    frames = folder / "frames"
    named = [str(frames / f"{moment}.png") for moment in range(3)]

    answers = [
        _json("reward", *words, *GOAL)[0]
        for words in (named, [str(frames)], [f"top={frames}"], ["--dataset", "demos", "--index", "0"])
    ]

    assert all(answer["rewards"] == [0, 0, 1] for answer in answers)
    assert all(answer["similarities"] == answers[0]["similarities"] for answer in answers)


def test_more_frames_than_one_request_takes_come_back_as_one_answer(folder: Path) -> None:
    (answer,) = _json("reward", *[str(folder / "frames" / "2.png")] * 40, *GOAL, "--raw")

    assert len(answer["rewards"]) == len(answer["winners"]) == 40
    assert answer["rewards"] == answer["similarities"]


def test_a_table_says_which_text_fits_best(folder: Path) -> None:
    lines = _run("reward", str(folder / "frames"), *GOAL).stdout.splitlines()

    assert lines[0].split() == ["frame", "reward", "similarity", "fits", "best"]
    assert [line.split()[-1] for line in lines[1:4]] == ["less", "less", "more"]


def test_a_table_names_the_words_that_the_model_does_not_know_and_asks_back(folder: Path) -> None:
    shown = _run("reward", str(folder / "frames"), "--goal", "more crimson on less amber", "--rival", "less")

    named = "The model does not know crimson, amber: the goal is never rewarded."
    assert shown.stdout.splitlines()[-2:] == [named, "Did you mean: more on top of less?"]
    assert "never" not in _run("reward", str(folder / "frames"), "--goal", "more crimson", "--raw").stdout


def test_heatmaps_are_drawn_beside_the_image(folder: Path) -> None:
    image, out = str(folder / "frames" / "0.png"), folder / "out.png"
    _, drawn = _json("reward", image, *GOAL, "--heatmap", str(out), "--phrase", "a red block", "--phrase", "b")

    with PIL.Image.open(io.BytesIO(out.read_bytes())) as picture:
        assert picture.size == (3 * 5 + 2 * 4, 4)
    assert [found["phrase"] for found in drawn["groundings"]] == ["a red block", "b"]
    assert drawn["groundings"][1]["x"] == pytest.approx(5 / 8)
    alone = _json("reward", image, "--heatmap", str(out), "--phrase", "a red block", "--phrase", "b")
    assert alone == [drawn]
    assert "--goal must be given" in _run("reward", image, "--heatmap", str(out), "--phrase", "b", "--raw").output


@pytest.mark.parametrize(
    ("words", "field"),
    [
        ([], "image"),
        (["x.png", "--dataset", "demos"], "image"),
        (["no/where.png"], "image"),
        (["--dataset", "demos", "--index", "1"], "index"),
        (["front=frames", "left=frames/0.png"], "image"),
        (["frames", "--index", "0"], "index"),
        (["--dataset", "demos", "--heatmap", "out.png"], "heatmap"),
        (["--dataset", "demos", "--heatmap", "out.gif", "--phrase", "a"], "heatmap"),
    ],
)
def test_what_cannot_be_asked_is_an_error_that_names_the_option(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], field: str
) -> None:
    monkeypatch.chdir(folder)
    result = _run("reward", *words, *GOAL, "--json")

    assert result.exit_code == 1
    assert json.loads(result.stderr)["error"]["field"] == field


def test_a_fit_that_is_refused_leaves_no_dataset_of_its_images(folder: Path) -> None:
    words = ("fit", "reward", "pictures", "--images", str(folder / "frames"), "--json")
    before = Dataset(folder / "datasets/demos").fingerprint
    for setting in ("steps", "nonsense=1"):
        assert _run(*words, "--set", setting).exit_code == 1
        assert [path.name for path in (folder / "datasets").iterdir()] == ["demos"]
    refused = _run("fit", "reward", "demos", "--images", str(folder / "frames"), "--replace", "--set", "x=1")
    assert refused.exit_code == 1
    assert _json("dataset", "list")[0]["datasets"] == ["demos"]
    assert Dataset(folder / "datasets/demos").fingerprint == before


def test_only_where_every_service_answers_there_is_no_such_fit(
    folder: Path, monkeypatch: pytest.MonkeyPatch, reserve_ports: Any
) -> None:
    for name, ports in reserve_ports(["segmentation", "imitation", "orchestrator"]).items():
        monkeypatch.setitem(PORTS, name, ports)

    assert _json("jobs", "list") == []
    for fit in ("0" * 32, "0"):
        error = json.loads(_run("jobs", "cancel", fit, "--json").stderr)["error"]
        assert error["code"] == "unavailable"
        assert "segmentation, imitation, orchestrator" in error["detail"]
    one = _run("jobs", "cancel", "0" * 32, "--service", "reward", "--json")
    assert json.loads(one.stderr)["error"]["code"] == "not_found"


def test_an_audit_says_precision_and_recall_beside_what_people_say(folder: Path) -> None:
    text = "more on top of less"
    rewarded = [reward > 0 for reward in _json("reward", str(folder / "frames"), "--goal", text)[0]["rewards"]]
    says = [not rewarded[0], *rewarded[1:]]  # one error
    lines = [f"{moment}.png,{text},{'yes' if each else 'no'}" for moment, each in enumerate(says)]
    table = ["image,text,holds", *lines, "0.png,more crimson on less,no", "0.png,more,no"]
    (folder / "frames" / "audit.csv").write_text("\n".join(table))

    found = _json("reward", "--audit", str(folder / "frames"))[0]["audit"]

    right = sum(a and b for a, b in zip(rewarded, says, strict=True))
    for name, count, of in (
        ("precision", right, sum(rewarded)),
        ("recall", right, sum(says)),
        ("false_positives", sum(rewarded) - right, 5 - sum(says)),
        ("holds", sum(says), 5),
    ):
        assert found[name]["of"] == of
        assert found[name]["value"] == (count / of if of else None)
    assert (found["unknown"], found["refused"]) == (["crimson"], ["more"])
    assert "never rewarded" in _run("reward", "--audit", str(folder / "frames")).stdout


@pytest.mark.parametrize(
    "words",
    [("--rival", "less"), ("--raw",), ("--heatmap", "out.png"), ("--phrase", "b"), ("--index", "0"), ("x.png",)],
    ids=" ".join,
)
def test_an_audit_is_given_no_option_that_it_would_ignore(folder: Path, words: tuple[str, ...]) -> None:
    refused = _run("reward", "--audit", str(folder / "frames"), *words, "--json")
    assert json.loads(refused.stderr)["error"]["field"] == "audit"


def test_a_fit_to_several_cameras_is_refused_an_audit_before_it_begins(folder: Path) -> None:
    (folder / "frames" / "audit.csv").write_text("image,text,holds\n0.png,more on less,no\n")
    words = ("fit", "reward", "demos", "--audit", str(folder / "frames"), "--set", 'cameras=["top", "left"]')
    refused = _run(*words, "--json")
    detail = json.loads(refused.stderr)["error"]["detail"]
    assert detail == "--audit must be of a model of one camera; got `top, left`."
    assert _json("jobs", "list", "--service", "reward") == []


@pytest.mark.parametrize(
    ("table", "field"),
    [
        (None, "audit"),
        ("image,text\n", "header"),
        ("image,text,holds\n", "audit"),
        ("image,text,holds\n0.png,more,perhaps\n", "holds"),
        ("image,text,holds\n0.png,,yes\n", "text"),
        ("image,text,holds\n7.png,more,yes\n", "image"),
        ("image,text,holds\n0.png,yes\n", "holds"),
    ],
)
def test_an_audit_that_cannot_be_read_is_refused_by_its_column_before_a_fit_begins(
    folder: Path, table: str | None, field: str
) -> None:
    if table is not None:
        (folder / "frames" / "audit.csv").write_text(table)
    for words in (("reward",), ("fit", "reward", "demos")):
        refused = _run(*words, "--audit", str(folder / "frames"), "--json")
        assert refused.exit_code == 1
        assert json.loads(refused.stderr)["error"]["field"] == field
    assert _json("jobs", "list", "--service", "reward") == []
