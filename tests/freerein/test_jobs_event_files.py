"""Event files, as TensorBoard reads them."""

import math
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from freerein.jobs.event_files import EventFile

ROW = {"episode_return": 2.5, "value_loss": -0.125, "steps_per_s": 300.0, "lr": math.nan, "rollouts/x": 1e300}


def curves(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Returns the points of each curve in a folder."""
    events = EventAccumulator(str(folder)).Reload()
    return {tag: [(each.step, each.value) for each in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def test_curves_are_grouped_and_values_that_are_not_finite_left_out(tmp_path: Path) -> None:
    EventFile(tmp_path, after=0).append(1_000_000, ROW)
    found = curves(tmp_path)
    assert found.keys() == {"rollout/episode_return", "train/value_loss", "time/steps_per_s", "rollouts/x"}
    assert found["train/value_loss"] == [(1_000_000, -0.125)]
    assert math.isfinite(found["rollouts/x"][0][1])


def test_what_an_attempt_writes_again_is_shown_once(tmp_path: Path) -> None:
    first = EventFile(tmp_path, after=0)
    for step in (1, 2, 3):
        first.append(step, {"loss": step})
    second = EventFile(tmp_path, after=1)
    for step in (2, 3):
        second.append(step, {"loss": -step})
    assert curves(tmp_path) == {"train/loss": [(1, 1), (2, -2), (3, -3)]}


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "tensorboard").write_text("in the way")
    EventFile(tmp_path / "tensorboard", after=0).append(1, ROW)
