"""`meta/episodes` as a table: one row per trajectory, all that is known of it without reading its frames.

Beside LeRobot's columns there are three of ours: the skills, and the data file's size and sha256. The size tells on
open which rows still describe their file; the hash identifies the contents.
"""

import hashlib
import io
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from freerein.data import layout, statistics
from freerein.data.spec import DatasetSpec
from freerein.data.statistics import STATISTICS, FeatureStatistics
from freerein.data.trajectory_file import read_footer
from freerein.errors import InvalidInput

Row: TypeAlias = dict[str, Any]

_INTEGERS = ("length", "data/chunk_index", "data/file_index", "dataset_from_index", "dataset_to_index", "data/bytes")


def schema(spec: DatasetSpec) -> pa.Schema:
    """Returns the table's columns for datasets of a spec."""
    integers = [(name, pa.int64()) for name in ("episode_index", *_INTEGERS)]
    statistics_ = [
        (f"stats/{feature}/{name}", _statistic_type(str(described["dtype"]), name))
        for feature, described in layout.features(spec).items()
        for name in STATISTICS
    ]
    own_place = [("meta/episodes/chunk_index", pa.int64()), ("meta/episodes/file_index", pa.int64())]
    lists = [("tasks", pa.list_(pa.string())), ("skills", pa.list_(pa.string()))]
    return pa.schema([*integers, *lists, ("data/sha256", pa.string()), *statistics_, *own_place])


def describe(data: bytes, *, index: int, first_frame: int) -> Row:
    """Returns the row of a data file, from the file alone.

    Args:
        data: The file's bytes.
        index: The trajectory's number in the dataset.
        first_frame: Number of its first frame in the dataset.

    Raises:
        InvalidInput: The file is corrupt, or freerein did not write it.
    """
    footer = read_footer(io.BytesIO(data), index=index)
    if footer is None:
        raise InvalidInput(
            f"Trajectory {index} must have been written by freerein like the others of its dataset; it was not.",
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
    """Returns a table with rows added at its end."""
    return pa.concat_tables([table, pa.Table.from_pylist(list(rows), schema=table.schema)]).combine_chunks()


def task_indices(table: pa.Table) -> dict[str, int]:
    """Returns the number of each different goal text, in order of first appearance."""
    return {text: number for number, text in enumerate(dict.fromkeys(text for (text,) in table["tasks"].to_pylist()))}


def frame_count(table: pa.Table) -> int:
    """Returns the number of timesteps of all trajectories together."""
    return int(pc.sum(table["length"]).as_py() or 0)


def dataset_statistics(table: pa.Table, spec: DatasetSpec) -> dict[str, FeatureStatistics]:
    """Returns the statistics of all trajectories together, by feature; empty for an empty dataset."""
    if table.num_rows == 0:
        return {}
    return {
        feature: statistics.combined({name: _stacked(table[f"stats/{feature}/{name}"]) for name in STATISTICS})
        for feature in layout.features(spec)
    }


def _statistic_type(dtype: str, name: str) -> pa.DataType:
    """Images have statistics (C, 1, 1), other features (D,), counts (1,)."""
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
