"""Texts of each timestep in LeRobot's datasets: its task, or its subtask."""

import math
import unicodedata
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import pyarrow as pa

from freerein.data import layout, lerobot_tables
from freerein.data.lerobot_features import SUBTASK_COLUMNS
from freerein.data.reader import Dataset
from freerein.data.trajectory_file import corrupt_as_invalid
from freerein.errors import InvalidInput, quoted

TextKind: TypeAlias = Literal["task", "subtask"]

_SUBTASKS_FILE = "meta/subtasks.parquet"
_STYLE = "subtask"
_ROUNDING_S = 1e-3
"""By how much a subtask may begin after the timestep of its first frame: times are sums of rounded numbers."""


class TimestepTexts:
    """The tasks, or the subtasks, of each trajectory of a dataset of LeRobot's.

    Raises InvalidInput where there are no subtasks, or their table is corrupt.
    """

    def __init__(self, root: Path, dataset: Dataset, kind: TextKind) -> None:
        self._dataset = dataset
        self._kind = kind
        columns = ("task_index",) if kind == "task" else tuple(filter(dataset.left_out.__contains__, SUBTASK_COLUMNS))
        if not columns:
            raise InvalidInput(
                f"A dataset must have subtasks in a column {' or '.join(map(quoted, SUBTASK_COLUMNS))}; this one has "
                "neither.",
                hint="Take its tasks instead, or tag it: freerein dataset tag NAME tags.csv.",
            )
        self._column = columns[0]
        file = layout.TASKS_FILE if kind == "task" else _SUBTASKS_FILE
        has_table = self._column.endswith("_index")
        self._texts = lerobot_tables.read_texts(root, file, kind) if has_table else dict[int, str]()

    def occurring(self, index: int) -> tuple[str, ...]:
        """Returns the texts of a trajectory, sorted; those of its tasks by the episodes table where that has them."""
        listed = self._dataset.tasks[index] if self._kind == "task" else ()
        return tuple(sorted({_clean(text) for text in listed or self.of_timesteps(index)} - {""}))

    def of_timesteps(self, index: int) -> list[str]:
        """Returns the text of each timestep of a trajectory; empty where there is none."""
        rows = self._dataset.stored_columns(index, [self._column])[self._column]
        with corrupt_as_invalid(f"`{self._column}`"):
            if not self._column.endswith("_index"):
                return _at_times(_beginnings(rows.to_pylist()), len(rows), fps=self._dataset.spec.fps)
            return [_clean(self._texts.get(each, "")) for each in rows.cast(pa.int64()).to_pylist()]


def _beginnings(rows: Sequence[Sequence[dict[str, Any]] | None]) -> list[tuple[float, str]]:
    """Returns when each subtask begins, in seconds, and its text: rows repeat all those of their episode."""
    found = {
        (float(each["timestamp"] or 0), _clean(str(each["content"] or "")))
        for row in rows
        for each in row or ()
        if each["style"] == _STYLE
    }
    if not all(math.isfinite(time_s) for time_s, _ in found):
        raise ValueError("not finite")
    return sorted(found)


def _at_times(beginnings: Sequence[tuple[float, str]], length: int, *, fps: int) -> list[str]:
    """Returns the text that holds at each timestep: the last one that has begun."""
    texts, current, following = list[str](), "", list(beginnings)[::-1]
    for step in range(length):
        while following and following[-1][0] <= step / fps + _ROUNDING_S:
            current = following.pop()[1]
        texts.append(current)
    return texts


def _clean(text: str) -> str:
    return " ".join(unicodedata.normalize("NFC", text).split())
