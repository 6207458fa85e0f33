"""The trials of an evaluation on disk."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein_orchestrator.kinds.evaluate.form import Trial
from freerein_orchestrator.kinds.evaluate.record import TrialRecord

Open = Callable[[], TrialRecord]


@pytest.fixture
def run(new_run: Callable[..., Any], tmp_path: Path) -> Any:
    return new_run(tmp_path, "evaluate", {"task": "grid", "policy": "random"})


@pytest.fixture
def reopen(run: Any) -> Open:
    """A function that opens the record as an attempt at the run does."""
    return lambda: TrialRecord(run.context(), 6)


def trial(number: int, *names: str) -> Trial:
    """Returns a trial with a frame of each name, all of them of the number's colour."""
    return Trial({"number": number}, {name: np.full((2, 2, 3), number, np.uint8) for name in names})


def content(record: TrialRecord) -> list[tuple[int, dict[str, int]]]:
    """Returns the number of each trial, and the colour of each of its frames."""
    return [
        (each.values["number"], {name: int(frame[0, 0, 0]) for name, frame in each.shown.items()})
        for each in record.trials()
    ]


def test_of_the_frames_of_one_name_only_the_first_trials_are_kept(run: Any, reopen: Open) -> None:
    record = reopen()
    record.add({"a": 1}, [trial(0, "x"), trial(1, "x", "y")])
    record.add({"a": 1}, [trial(2, "y"), trial(3, "z")])
    kept = [(0, {"x": 0}), (1, {"y": 1}), (2, {}), (3, {"z": 3})]
    assert content(record) == content(reopen()) == kept
    assert reopen().subject == {"a": 1}
    assert len(list((run.folder / "checkpoints" / "frames").iterdir())) == 3


def test_a_round_that_a_crash_tore_is_measured_again_with_its_frames(run: Any, reopen: Open) -> None:
    reopen().add({}, [trial(0, "x")])
    reopen().add({}, [trial(7, "y")])
    path = run.folder / "checkpoints" / "rounds.jsonl"
    path.write_bytes(path.read_bytes()[:-5])
    record = reopen()
    assert content(record) == [(0, {"x": 0})]
    record.add({}, [trial(1)])
    record.add({}, [trial(2, "y")])
    assert content(record) == content(reopen()) == [(0, {"x": 0}), (1, {}), (2, {"y": 2})]


def test_rows_of_metrics_that_are_there_are_kept_and_those_that_are_missing_appended(run: Any, reopen: Open) -> None:
    reopen().add({}, [trial(1), trial(2), trial(3)])
    path = run.folder / "metrics.jsonl"
    first, second, _ = path.read_text().splitlines(keepends=True)
    path.write_text(first.replace("1.0", "1.5") + second)
    reopen()
    assert [(row["step"], row["number"]) for row in run.rows] == [(1, 1.5), (2, 2), (3, 3)]


def test_rounds_may_be_long_and_are_appended(run: Any, reopen: Open) -> None:
    path = run.folder / "checkpoints" / "rounds.jsonl"
    reopen().add({}, [Trial({"confidence": [0.123456789] * 50_000})])
    first = path.read_bytes()
    reopen().add({}, [trial(1)])
    assert path.read_bytes().startswith(first)
    assert [list(each.values) for each in reopen().trials()] == [["confidence"], ["number"]]
