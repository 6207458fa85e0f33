"""`meta/`: the dataset's index, the episodes table in it, and the lock of its writer.

The table has one row per trajectory. Beside LeRobot's columns it has the skills, and the data file's size and sha256:
the size tells on open which rows still describe their file; the hash identifies the contents. The data files are
authoritative: `meta/` is rebuilt where it differs from them.
"""

import fcntl
import hashlib
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from freerein.atomic_files import write_atomic
from freerein.data import json_files, layout, statistics, tags
from freerein.data.layout import DatasetSpec, dumps, loads
from freerein.data.statistics import QUANTILES, STATISTICS, FeatureStatistics
from freerein.data.tags import Tags
from freerein.data.trajectory_file import read_footer
from freerein.errors import FailedPrecondition, InvalidInput, quoted
from freerein.regular_files import open_regular, read_regular

Row: TypeAlias = dict[str, Any]

_FILES = (layout.SPEC_FILE, layout.TASKS_FILE, layout.EPISODES_FILE, layout.STATS_FILE, layout.INFO_FILE)
_MOST_DATA_BYTES = 2**33
"""Largest data file: a long trajectory has gigabytes."""

_INTEGERS = ("length", "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index", "data/bytes")


class WriterLock:
    """Held by the one process that may write to a folder; the kernel frees it when that process dies.

    Args:
        root: The folder.
        noun: What it holds, at the beginning of a sentence.

    Raises:
        FailedPrecondition: Another process holds it.
    """

    def __init__(self, root: Path, *, noun: str = "A dataset") -> None:
        self._descriptor = os.open(root / "writer.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise FailedPrecondition(
                f"{noun} must have one writer at a time; another is writing.",
                hint="Close the other writer, or write to another dataset.",
            ) from None

    def close(self) -> None:
        """Releases the lock; may be called once."""
        os.close(self._descriptor)


def read_spec(root: Path) -> DatasetSpec | None:
    """Returns the spec, from the first data file if `meta/` is lost; None when freerein did not write the dataset.

    Its skills are those of tags that were given later, where there are any.
    """
    spec, given = _recorded_spec(root), tags.read(root)
    return replace(spec, skills=given.skills) if spec and given else spec


def _recorded_spec(root: Path) -> DatasetSpec | None:
    stored, first = root / layout.SPEC_FILE, layout.trajectory_path(root / "data", 0)
    if stored.is_file():
        return loads(read_regular(stored, name=layout.SPEC_FILE))
    if not first.is_file():
        return None
    try:
        with open_regular(first, name="Trajectory 0") as file:
            footer = read_footer(file, index=0)
    except InvalidInput:
        if (root / layout.INFO_FILE).is_file():
            return None  # written by another tool: only its own `meta/` describes it
        raise
    return footer.spec if footer else None


def load(root: Path, spec: DatasetSpec) -> tuple[pa.Table, bool]:
    """Returns the episodes table of the data files, and whether `meta/` agrees with it.

    Rows of `meta/` are used as long as their file has the recorded size; the rest is read from the files.
    """
    files = layout.numbered_files(root / "data")
    missing = next((index for index, file in enumerate(files) if file.index != index), None)
    if missing is not None:
        raise InvalidInput(
            f"The data files must be numbered without a gap; trajectory {missing} is missing.",
            hint="Restore the missing file from a copy.",
        )
    stored = read_episodes(root, spec)
    valid = _valid_rows(stored, files)
    table = stored.slice(0, valid)
    frames, rows = frame_count(table), list[Row]()
    for index in range(valid, len(files)):
        rows.append(describe(read_data_file(root, index), index=index, first_frame=frames))
        frames += rows[-1]["length"]
    is_current = valid == stored.num_rows == len(files) and read_counts(root) == (len(files), frames)
    recorded, given = extended(table, rows), tags.read(root)
    tagged = with_tags(recorded, given) if given else recorded
    has_tags = tagged["skills"].equals(recorded["skills"])
    return tagged, is_current and has_tags and all((root / name).is_file() for name in _FILES)


def with_tags(episodes: pa.Table, given: Tags) -> pa.Table:
    """Returns an episodes table with tags that were given later."""
    column = episodes.schema.get_field_index("skills")
    tagged = given.applied(episodes["episode_index"].to_pylist(), episodes["skills"].to_pylist())
    skills = pa.array(tagged, pa.list_(pa.string()))
    return episodes.set_column(column, "skills", skills)


def load_and_repair(root: Path, spec: DatasetSpec) -> pa.Table:
    """Returns the episodes table of the data files, and rewrites `meta/` where it differs.

    A reader without write access, or beside a writer, gets the same table and leaves `meta/` alone.
    """
    table, is_current = load(root, spec)
    if not is_current:
        with suppress(FailedPrecondition, OSError), closing(WriterLock(root)):
            if len(layout.numbered_files(root / "data")) == len(table):  # no writer came and went meanwhile
                save(root, spec, table)
    return table


def save(root: Path, spec: DatasetSpec, table: pa.Table) -> None:
    """Writes all of `meta/`, `info.json` last: it commits the rest."""
    combined = _dataset_statistics(table, spec)
    stats = {feature: {name: each[name].tolist() for name in each} for feature, each in combined.items()}
    tasks = list(task_indices(table)) or [spec.task]
    counts = layout.info(spec, trajectories=table.num_rows, frames=frame_count(table), tasks=len(tasks))
    write_atomic(root / layout.SPEC_FILE, dumps(spec).encode())
    write_atomic(root / layout.TASKS_FILE, _parquet(_tasks(tasks)))
    write_atomic(root / layout.EPISODES_FILE, _parquet(table))
    write_atomic(root / layout.STATS_FILE, json.dumps(stats, indent=4).encode())
    write_atomic(root / layout.INFO_FILE, json.dumps(counts, indent=4).encode())


def read_episodes(root: Path, spec: DatasetSpec) -> pa.Table:
    """Returns the episodes table of `meta/`; empty when it is missing or cannot be read."""
    schema = episodes_schema(spec)
    try:
        data = read_regular(root / layout.EPISODES_FILE, name=layout.EPISODES_FILE, most_bytes=_MOST_DATA_BYTES)
        table = pq.ParquetFile(pa.BufferReader(data)).read(use_threads=False)
    except (pa.ArrowException, OSError, InvalidInput):
        return schema.empty_table()
    table = _with_quantiles(table, schema)
    return table.cast(schema) if table.schema.equals(schema) else schema.empty_table()


def read_counts(root: Path) -> tuple[int, int] | None:
    """Returns the numbers of trajectories and frames in `info.json`; None when it cannot be read."""
    try:
        info = json_files.parse(read_regular(root / layout.INFO_FILE, name=layout.INFO_FILE))
        return int(info["total_episodes"]), int(info["total_frames"])
    except (OSError, ValueError, KeyError, TypeError, InvalidInput):
        return None


def episodes_schema(spec: DatasetSpec) -> pa.Schema:
    """Returns the columns of the episodes table."""
    integers = [(name, pa.int64()) for name in ("episode_index", *_INTEGERS)]
    statistics_ = [
        (f"stats/{feature}/{name}", _statistic_type(str(column["dtype"]), name))
        for feature, column in layout.features(spec).items()
        for name in STATISTICS
    ]
    own_place = [("meta/episodes/chunk_index", pa.int64()), ("meta/episodes/file_index", pa.int64())]
    lists = [("tasks", pa.list_(pa.string())), ("skills", pa.list_(pa.string()))]
    return pa.schema([*integers, *lists, ("data/sha256", pa.string()), *statistics_, *own_place])


def read_data_file(root: Path, index: int) -> bytes:
    """Returns the contents of a data file; raises InvalidInput where it is no regular file, or too large."""
    path = layout.trajectory_path(root / "data", index)
    return read_regular(path, name=f"Trajectory {index}", most_bytes=_MOST_DATA_BYTES)


def describe(data: bytes, *, index: int, first_frame: int) -> Row:
    """Returns the episodes row of the bytes of a data file; the indices count within the dataset."""
    footer = read_footer(io.BytesIO(data), index=index)
    if footer is None:
        raise InvalidInput(
            f"Trajectory {index} must have been written by freerein, as its dataset was; its file has no such footer.",
            hint="Move data files of other tools into a dataset of their own.",
        )
    return {
        "episode_index": index,
        "length": footer.length,
        "data/chunk_index": index // layout.CHUNK_SIZE,
        "data/file_index": index % layout.CHUNK_SIZE,
        "dataset_from_index": first_frame,
        "dataset_to_index": first_frame + footer.length,
        "data/bytes": len(data),
        "tasks": [footer.goal_text or footer.spec.task],
        "skills": list(footer.skills),
        "data/sha256": hashlib.sha256(data).hexdigest(),
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **{
            f"stats/{feature}/{name}": values.tolist()
            for feature, each in footer.statistics.items()
            for name, values in each.items()
        },
    }


def extended(table: pa.Table, rows: Iterable[Row]) -> pa.Table:
    """Returns a table with rows appended."""
    return pa.concat_tables([table, pa.Table.from_pylist(list(rows), schema=table.schema)]).combine_chunks()


def task_indices(table: pa.Table) -> dict[str, int]:
    """Returns the index of each distinct goal text, in order of first appearance."""
    return {text: number for number, text in enumerate(dict.fromkeys(text for (text,) in table["tasks"].to_pylist()))}


def frame_count(table: pa.Table) -> int:
    """Returns the total number of timesteps."""
    return int(pc.sum(table["length"]).as_py() or 0)


def save_teachers(root: Path, teachers: Sequence[Mapping[str, Any]]) -> None:
    """Writes `teachers.json`: cards of the policies that acted in the trajectories.

    A learner reads `supervision`, what the policy was trained with, and `privileged`, whether it saw true state.
    """
    write_atomic(root / layout.TEACHERS_FILE, json.dumps(list(teachers), indent=2).encode() + b"\n")


def read_teachers(root: Path) -> list[dict[str, Any]]:
    """Returns the cards of the policies that acted; empty for demonstrations."""
    path = root / layout.TEACHERS_FILE
    if not path.is_file():
        return []
    try:
        return [dict(card) for card in json_files.read(path, name=layout.TEACHERS_FILE)]
    except (ValueError, TypeError) as error:
        rule = "`teachers.json` must hold the cards of policies as freerein wrote them"
        sentence = f"{rule}; reading it failed: {quoted(repr(error))}."
        raise InvalidInput(sentence, hint="Restore it from a copy.") from None


def _with_quantiles(stored: pa.Table, schema: pa.Schema) -> pa.Table:
    """Returns a table of an earlier version, which had no quantiles, in the present columns; any other as it is."""
    present = set(stored.column_names)  # which pyarrow makes anew each time
    missing = [field for field in schema if field.name not in present]
    if not missing or not all(field.name.rpartition("/")[2] in QUANTILES for field in missing):
        return stored
    for field in missing:
        stored = stored.append_column(field, pa.nulls(len(stored), field.type))
    return stored.select(schema.names)


def _valid_rows(stored: pa.Table, files: list[layout.DataFile]) -> int:
    """Returns the number of leading rows whose file has the recorded size."""
    sizes = stored["data/bytes"].to_numpy()[: len(files)]
    changed = np.flatnonzero(sizes != np.array([file.size for file in files[: len(sizes)]], np.int64))
    return int(changed[0]) if len(changed) else len(sizes)


def _tasks(texts: list[str]) -> pa.Table:
    """LeRobot reads this table with pandas and wants the text as its index, which only pandas' own metadata can say."""
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
            {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"},
        ],
    }
    table = pa.table({"task_index": pa.array(range(len(texts)), pa.int64()), "task": pa.array(texts, pa.string())})
    return table.replace_schema_metadata({b"pandas": json.dumps(pandas).encode()})


def _parquet(table: pa.Table) -> bytes:
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def _dataset_statistics(table: pa.Table, spec: DatasetSpec) -> dict[str, FeatureStatistics]:
    """Returns the statistics over all trajectories, by feature; empty for an empty dataset.

    Quantiles are left out where a trajectory has none.
    """
    if table.num_rows == 0:
        return {}
    columns = {
        feature: {name: table[f"stats/{feature}/{name}"] for name in STATISTICS} for feature in layout.features(spec)
    }
    return {
        feature: statistics.combined({name: _stacked(column) for name, column in each.items() if not column.null_count})
        for feature, each in columns.items()
    }


def _statistic_type(dtype: str, name: str) -> pa.DataType:
    """Statistics of images are (C, 1, 1), of other features (D,), counts (1,)."""
    if name == "count":
        return pa.list_(pa.int64())
    return pa.list_(pa.list_(pa.list_(pa.float64()))) if dtype == "image" else pa.list_(pa.float64())


def _stacked(column: pa.ChunkedArray) -> npt.NDArray[np.float64]:
    """Returns n nested lists of one shape as an array (n, ...)."""
    shape = np.shape(column[0].as_py())
    flat = pa.concat_arrays(column.chunks)
    while pa.types.is_nested(flat.type):
        flat = flat.flatten()
    values: npt.NDArray[np.float64] = flat.to_numpy(zero_copy_only=False).astype(np.float64)
    return values.reshape(len(column), *shape)
