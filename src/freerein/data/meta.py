"""The folder `meta/`: written last, read first, and never believed against the data files."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.atomic_files import write_atomic
from freerein.data import episodes, layout
from freerein.data.episodes import Row
from freerein.data.lock import WriterLock
from freerein.data.spec import DatasetSpec, dumps, loads
from freerein.data.trajectory_file import read_footer
from freerein.errors import FailedPrecondition, InvalidInput

_FILES = (layout.SPEC_FILE, layout.TASKS_FILE, layout.EPISODES_FILE, layout.STATS_FILE, layout.INFO_FILE)


def read_spec(root: Path) -> DatasetSpec | None:
    """Returns a dataset's spec, from the first data file if `meta/` is lost; None when freerein did not write it.

    Raises:
        InvalidInput: The spec is corrupt, or `meta/` is lost and the first data file is corrupt.
    """
    stored, first = root / layout.SPEC_FILE, layout.trajectory_path(root / "data", 0)
    if stored.is_file():
        return loads(stored.read_bytes())
    if not first.is_file():
        return None
    try:
        with first.open("rb") as file:
            footer = read_footer(file, index=0)
    except InvalidInput:
        if (root / layout.INFO_FILE).is_file():
            return None  # another tool's: its own `meta/` is all there is
        raise
    return footer.spec if footer else None


def load(root: Path, spec: DatasetSpec) -> tuple[pa.Table, bool]:
    """Returns the episodes table as the data files say, and whether `meta/` says the same.

    Rows are taken from `meta/` as long as their file has the size recorded there; the rest is read from the files.

    Raises:
        InvalidInput: A data file is missing or corrupt.
    """
    files = layout.numbered_files(root / "data")
    missing = next((index for index, file in enumerate(files) if file.index != index), None)
    if missing is not None:
        raise InvalidInput(
            f"The data files must be numbered without a gap; trajectory {missing} is missing.",
            hint="Restore the missing file from a copy.",
        )
    stored = read_episodes(root, spec)
    believed = _believed(stored, files)
    table = stored.slice(0, believed)
    frames, rows = episodes.frame_count(table), list[Row]()
    for index in range(believed, len(files)):
        data = layout.trajectory_path(root / "data", index).read_bytes()
        rows.append(episodes.describe(data, index=index, first_frame=frames))
        frames += rows[-1]["length"]
    table = episodes.extended(table, rows)
    is_fresh = believed == stored.num_rows == len(files) and read_counts(root) == (len(files), frames)
    return table, is_fresh and all((root / name).is_file() for name in _FILES)


def load_mended(root: Path, spec: DatasetSpec) -> pa.Table:
    """Returns the episodes table as the data files say, and rewrites `meta/` where it says otherwise.

    A reader that may not write, or that reads beside a writer at work, gets the same table and leaves `meta/` alone.

    Raises:
        InvalidInput: A data file is missing or corrupt.
    """
    table, is_fresh = load(root, spec)
    if not is_fresh:
        with contextlib.suppress(FailedPrecondition, OSError), WriterLock(root):
            if len(layout.numbered_files(root / "data")) == len(table):  # no writer came and went meanwhile
                save(root, spec, table)
    return table


def save(root: Path, spec: DatasetSpec, table: pa.Table) -> None:
    """Writes all of `meta/`, the counts last: they commit the rest."""
    combined = episodes.dataset_statistics(table, spec)
    stats = {feature: {name: each[name].tolist() for name in each} for feature, each in combined.items()}
    tasks = list(episodes.task_indices(table)) or [spec.task]
    counts = layout.info(spec, trajectories=table.num_rows, frames=episodes.frame_count(table), tasks=len(tasks))
    write_atomic(root / layout.SPEC_FILE, dumps(spec).encode())
    write_atomic(root / layout.TASKS_FILE, _parquet(_tasks(tasks)))
    write_atomic(root / layout.EPISODES_FILE, _parquet(table))
    write_atomic(root / layout.STATS_FILE, json.dumps(stats, indent=4).encode())
    write_atomic(root / layout.INFO_FILE, json.dumps(counts, indent=4).encode())


def read_episodes(root: Path, spec: DatasetSpec) -> pa.Table:
    """Returns the episodes table as it stands in `meta/`; empty when there is none that can be read."""
    schema = episodes.schema(spec)
    try:
        data = pa.BufferReader((root / layout.EPISODES_FILE).read_bytes())
        table = pq.ParquetFile(data).read(use_threads=False)
    except (pa.ArrowException, OSError):
        return schema.empty_table()
    return table.cast(schema) if table.schema.equals(schema) else schema.empty_table()


def read_counts(root: Path) -> tuple[int, int] | None:
    """Returns the numbers of trajectories and frames as they stand in `info.json`; None when it cannot be read."""
    try:
        info = json.loads((root / layout.INFO_FILE).read_text())
        return int(info["total_episodes"]), int(info["total_frames"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _believed(stored: pa.Table, files: list[layout.DataFile]) -> int:
    """How many leading rows still have the file that they describe."""
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
