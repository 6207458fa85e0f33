"""LeRobot's column `language_persistent` of version 3.1: at each timestep, the texts of its whole episode.

A text has a style, such as `subtask` or `plan`, and the time at which it begins to hold.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from freerein.data.lerobot_tables import is_text, with_column
from freerein.errors import InvalidInput

COLUMN = "language_persistent"
FEATURE = {"dtype": "language", "shape": [1], "names": None}
"""Its entry of `features` in `info.json`."""

SUBTASK = "subtask"
_ROW = pa.struct(
    [
        ("role", pa.string()),
        ("content", pa.string()),
        ("style", pa.string()),
        ("timestamp", pa.float32()),
        ("camera", pa.string()),
        ("tool_calls", pa.list_(pa.field("element", pa.string()))),  # as it is read back
    ]
)
_READ: dict[str, Callable[[pa.DataType], bool]] = {
    "content": is_text,
    "style": is_text,
    "timestamp": pa.types.is_floating,
}

Subtasks: TypeAlias = Mapping[int, Sequence[tuple[float, str]]]
"""When each subtask begins, in seconds, and its text, by `episode_index`; an empty text ends the one before."""


def subtasks_of(rows: pa.Table) -> set[tuple[int, float, str]]:
    """Returns the subtasks of rows that have the column: `episode_index`, when each begins, and its text."""
    lists = _lists(rows)
    if lists is None:
        return set()
    values, is_subtask = lists.flatten(), _is_subtask(lists)
    numbers = rows["episode_index"].to_numpy()[_parents(lists)][is_subtask].tolist()
    found = values.filter(pa.array(is_subtask))
    times, texts = (found.field(name).to_pylist() for name in ("timestamp", "content"))
    return {(number, float(time or 0), text or "") for number, time, text in zip(numbers, times, texts, strict=True)}


def with_subtasks(rows: pa.Table, subtasks: Subtasks) -> pa.Table:
    """Returns rows of a data file with these subtasks in place of others; texts of other styles stay."""
    lists, numbers = _lists(rows), rows["episode_index"].to_numpy()
    kept, parents = _others(lists) if lists is not None else (pa.array([], _ROW), np.empty(0, np.int64))
    found = list(dict.fromkeys(numbers.tolist()))
    counts = {number: len(subtasks.get(number, ())) for number in found}
    new = _new_rows([each for number in found for each in subtasks.get(number, ())], kept.type)
    first = dict(zip(found, np.cumsum([len(kept), *counts.values()])[:-1].tolist(), strict=True))
    added = [np.arange(first[number], first[number] + counts[number]) for number in numbers.tolist()]
    owners = np.concatenate([parents, np.repeat(np.arange(len(rows)), [len(each) for each in added])])
    places = np.concatenate([np.arange(len(kept)), *added])[np.argsort(owners, kind="stable")]
    offsets = np.append(0, np.cumsum(np.bincount(owners, minlength=len(rows))))
    joined = pa.concat_arrays([kept, new]).take(pa.array(places, pa.int64()))
    column = pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), joined)
    return with_column(rows, COLUMN, column)


def _lists(rows: pa.Table) -> pa.ListArray | None:
    """Returns the column, whose rows have our type where they have none; None where there is none or it is empty.

    Raises InvalidInput where it holds anything but lists of texts with a style and a time.
    """
    if COLUMN not in rows.column_names or not len(rows):
        return None
    lists = pa.concat_arrays(rows[COLUMN].chunks)
    is_list = pa.types.is_list(lists.type) or pa.types.is_large_list(lists.type)
    element = lists.type.value_type if is_list else lists.type
    if pa.types.is_null(element):
        return None  # no text at all
    if not is_list or not pa.types.is_struct(element):
        raise _invalid(f"got {'lists of ' if is_list else ''}{element}")
    known = {each.name: each.type for each in _ROW}
    fields = [
        each.with_type(known.get(each.name, each.type)) if pa.types.is_null(each.type) else each for each in element
    ]
    kinds = {each.name: each.type for each in fields}
    for name, is_kind in _READ.items():
        if name not in kinds or not is_kind(kinds[name]):
            raise _invalid(f"`{name}` is {kinds.get(name, 'missing')}")
    return lists.cast(pa.list_(pa.struct(fields)))


def _invalid(found: str) -> InvalidInput:
    return InvalidInput(
        f"`{COLUMN}` must have lists of rows, with texts `content` and `style` and a float `timestamp`; {found}.",
        hint="Write the column again with LeRobot, or remove it from the data and from `info.json`.",
    )


def _others(lists: pa.ListArray) -> tuple[pa.StructArray, npt.NDArray[np.int64]]:
    """Returns the texts of other styles, and the row of each."""
    is_other = ~_is_subtask(lists)
    return lists.flatten().filter(pa.array(is_other)), _parents(lists)[is_other]


def _parents(lists: pa.ListArray) -> npt.NDArray[np.int64]:
    parents: npt.NDArray[np.int64] = pc.list_parent_indices(lists).to_numpy().astype(np.int64)
    return parents


def _is_subtask(lists: pa.ListArray) -> npt.NDArray[np.bool_]:
    styles = lists.flatten().field("style").cast(pa.string())
    is_subtask: npt.NDArray[np.bool_] = pc.equal(styles, SUBTASK).fill_null(False).to_numpy(zero_copy_only=False)
    return is_subtask


def _new_rows(subtasks: Sequence[tuple[float, str]], kind: pa.StructType) -> pa.StructArray:
    """Returns subtasks as rows of a type, whose other fields are null."""
    count = len(subtasks)
    known: dict[str, list[Any]] = {
        "role": ["assistant"] * count,
        "content": [text for _, text in subtasks],
        "style": [SUBTASK] * count,
        "timestamp": [time_s for time_s, _ in subtasks],
    }
    fields = [
        pa.array(known[each.name]).cast(each.type) if each.name in known else pa.nulls(count, each.type)
        for each in kind
    ]
    return pa.StructArray.from_arrays(fields, fields=list(kind))
