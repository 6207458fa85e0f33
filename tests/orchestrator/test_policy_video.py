"""Videos of policies: what they show, and what happens without PyAV."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.video.reader import open_video
from freerein_orchestrator.kinds import policy_video
from freerein_orchestrator.kinds.policy_video import MAX_FRAMES, VIDEO, can_film, max_frames, save_video


@pytest.fixture
def context(new_run: Callable[..., Any], tmp_path: Path) -> Any:
    return new_run(tmp_path, "evaluate", {"task": "grid", "policy": "random"}).context()


@pytest.mark.parametrize(("size", "shown"), [((33, 31, 1), (232, 218)), ((300, 301, 3), (300, 302))])
def test_frames_are_enlarged_and_played_at_the_tasks_pace(
    context: Any, size: tuple[int, ...], shown: tuple[int, int]
) -> None:
    frames = np.repeat(np.array([40, 200], np.uint8), 3)[:, None, None, None] * np.ones((1, *size), np.uint8)
    save_video(context, frames, dt_s=0.1)
    with open_video(context.artifacts / VIDEO) as video:
        read = list(video)
        assert (video.info.height, video.info.width) == shown
    assert [each.time_s for each in read] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert [round(float(each.pixels.mean()), -1) for each in read] == [40, 40, 40, 200, 200, 200]


def test_a_video_is_bounded(context: Any) -> None:
    save_video(context, np.zeros((MAX_FRAMES + 9, 8, 8, 3), np.uint8), dt_s=0.05)
    with open_video(context.artifacts / VIDEO) as video:
        assert sum(1 for _ in video) == MAX_FRAMES


def test_without_pyav_the_log_says_so(
    context: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert can_film(context)
    monkeypatch.setattr(policy_video, "find_spec", lambda _name: None)
    assert not can_film(context)
    assert "freerein[video]" in capsys.readouterr().err


@pytest.mark.parametrize(("dt_s", "fps"), [(0.0, 240), (3600.0, 1)])
def test_any_pace_can_be_shown(context: Any, dt_s: float, fps: int) -> None:
    save_video(context, np.zeros((3, 8, 8, 3), np.uint8), dt_s=dt_s)
    with open_video(context.artifacts / VIDEO) as video:
        assert video.info.fps == pytest.approx(fps)


def test_a_pyav_that_cannot_encode_ends_no_run(
    context: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(policy_video, "_CODEC", "missing")
    save_video(context, np.zeros((3, 8, 8, 3), np.uint8), dt_s=0.1)
    assert "cannot encode" in capsys.readouterr().err
    assert not list(context.artifacts.iterdir())


def test_large_frames_are_fewer() -> None:
    assert max_frames(64, 64) == MAX_FRAMES
    assert max_frames(1024, 1024) == 85
