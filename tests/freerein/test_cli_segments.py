"""`freerein segment` of a video and of a trajectory: the timeline in the terminal, as JSON, PNG and WebVTT."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from rich.console import Console
from typer.testing import CliRunner, Result

from freerein.cli.__main__ import app
from freerein.cli.segments import picture, timeline
from freerein.cli.segments.timeline import at_rate, of_video
from freerein.cli.segments.webvtt import webvtt
from freerein.types.common import ModelRef, Timing
from freerein.types.segmentation import Segment, SegmentResponse

FAULTS = Path(__file__).parents[1] / "faults"


def answer(*segments: Segment, timesteps: int, time_s: Any = ()) -> SegmentResponse:
    labels = np.full(timesteps, -1)
    for each in segments:
        labels[each.start : each.end] = ("push", "a <b> & c").index(each.skill)
    ones = np.ones(timesteps, np.float32)
    times = np.array(time_s, np.float32)
    return SegmentResponse(labels, ones, ones, segments, ("push", "a <b> & c"), ModelRef("m"), Timing(), times)


PARTS = (Segment(0, 25, "push", 0.9), Segment(30, 36_000, "a <b> & c", 0.8))


def test_subtitles_last_as_long_as_their_segments_and_hold_no_markup() -> None:
    assert webvtt(at_rate(answer(*PARTS, timesteps=36_000), fps=10).cues) == (
        "WEBVTT\n\n00:00:00.000 --> 00:00:02.500\npush\n\n00:00:03.000 --> 01:00:00.000\na &lt;b&gt; &amp; c\n"
    )


def test_the_times_of_a_video_are_its_own_and_its_last_frame_lasts() -> None:
    labelled = of_video(answer(Segment(0, 3, "push", 0.9), timesteps=3, time_s=[0.0, 0.5, 1.5]))
    assert labelled.time_s.tolist() == pytest.approx([0.0, 0.5, 1.5, 2.25])


def test_the_share_of_timesteps_unlike_the_fit_is_shown_where_there_are_many(
    capsys: pytest.CaptureFixture[str],
) -> None:
    familiar = answer(Segment(0, 4, "push", 0.9), timesteps=4)
    timeline.show(at_rate(familiar, fps=10), Console())
    assert "unlike" not in capsys.readouterr().out

    timeline.show(at_rate(replace(familiar, in_distribution=np.float32([0.02, 0.5, 0.03, 1.0])), fps=10), Console())
    assert "25% of the timesteps are probably unlike" in capsys.readouterr().out


@pytest.mark.parametrize(("fps", "trained", "is_warned"), [(30, 10, True), (10, 10, False), (30, 0, False)])
def test_a_dataset_of_another_rate_than_the_model_is_warned_of(fps: float, trained: float, is_warned: bool) -> None:
    assert ("--fps 10" in timeline.rate_warning(fps, trained)) == is_warned


def test_a_picture_is_drawn_with_and_without_frames(tmp_path: Path) -> None:
    labelled = at_rate(answer(Segment(0, 4, "push", 0.9), timesteps=6), fps=10)
    for name, film in (("with", [np.zeros((4, 6, 1), np.uint8)] * 3), ("without", [])):
        picture.draw(tmp_path / f"{name}.png", labelled, film)
        with PIL.Image.open(tmp_path / f"{name}.png") as drawn:
            assert drawn.width == 1960


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("tests.faults.faulty_service", FREEREIN_SHIPPED_DIR="none", FAULTY_SIDE="16")


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["segment", *words])


@pytest.mark.e2e
def test_a_video_file_is_labelled_drawn_and_subtitled(
    service: Any, encode_video: Callable[..., bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_SEGMENTATION_ADDRESS", service.address)
    demo, png, vtt = tmp_path / "demo.mp4", tmp_path / "demo.png", tmp_path / "demo.vtt"
    demo.write_bytes(encode_video(np.zeros((8, 32, 32, 3), np.uint8)))

    refused = run(str(demo), "--json")
    assert json.loads(refused.stderr)["error"]["field"] == "video"
    document = json.loads(run(str(demo), "--resize", "--json", "--png", str(png), "--vtt", str(vtt)).stdout)

    assert document["labels"] == [0] * 8
    assert document["time_s"] == pytest.approx(np.arange(8) / 10)
    assert document["fps"] == 0  # the model does not know its rate
    slower = json.loads(run(str(demo), "--resize", "--fps", "5", "--json", "--png", str(png)).stdout)
    assert (slower["labels"], slower["fps"], slower["time_s"][1]) == ([0] * 4, 5, pytest.approx(0.2))
    assert "4 timesteps, 5 per second, " in run(str(demo), "--resize", "--fps", "5").stdout
    assert png.stat().st_size > 0
    assert vtt.read_text() == "WEBVTT\n\n00:00:00.000 --> 00:00:00.800\neven\n"
    shown = run(str(demo), "--resize", "--min-kept", "9").stdout
    assert "········" in shown
    assert "8 of them rejected" in shown


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("words", "field"),
    [
        (["none.mp4"], "source"),
        ([__file__], "source"),
        (["a/folder"], "dataset"),
        (["demo.mp4", "--save"], "save"),
        (["demo.mp4", "--index", "0"], "index"),
        (["demo.mp4", "--camera", "top"], "camera"),
        (["demos", "--resize"], "resize"),
        (["demos", "--fps", "10"], "fps"),
        (["demo.MOV", "--save"], "save"),
        (["demos", "--actions", "actions.csv"], "actions"),
        (["demos", "--save", "--index", "0"], "index"),
        (["demos", "--save", "--png", "timeline.png"], "png"),
        (["demos", "--save", "--vtt", "demos.vtt"], "vtt"),
    ],
)
def test_what_cannot_be_labelled_or_would_be_ignored_is_an_error(words: list[str], field: str) -> None:
    result = run(*words, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stderr)["error"]["field"] == field


@pytest.mark.parametrize("option", ["--min-segment", "--min-kept"])
def test_a_length_that_no_service_takes_is_refused_with_its_range(option: str) -> None:
    result = run("demos", option, "99999999999")
    assert result.exit_code == 2
    assert "1000" in result.stderr
