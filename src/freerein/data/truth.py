"""The door to ground truth, for evaluation only: per-timestep skill labels beside a dataset, never in it.

    <root>/truth/chunk-000/file-000.parquet    the labels of data/chunk-000/file-000.parquet

Learners read with `freerein.data.reader`, which does not import this module.
"""

import io
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.atomic_files import write_atomic
from freerein.data import layout
from freerein.data.rows import refusing_corruption
from freerein.errors import NotFound

_FOLDER = "truth"


def labels(root: Path, index: int) -> npt.NDArray[np.int64]:
    """Returns the skill in execution at each timestep of a trajectory.

    Returns:
        int64 (T,), indices into the `skills` of the dataset's spec.

    Raises:
        NotFound: There is no such trajectory, or no labels were recorded with it.
        InvalidInput: The labels are corrupt.
    """
    path = layout.trajectory_path(root / _FOLDER, index)
    if not path.is_file() or not layout.trajectory_path(root / "data", index).is_file():
        raise NotFound(
            f"There must be labels of trajectory {index}; none were recorded.",
            hint="Record the demonstrations in a privileged session.",
        )
    with refusing_corruption(f"The labels of trajectory {index}"), path.open("rb") as file:
        table = pq.ParquetFile(file, page_checksum_verification=True).read(use_threads=False)
        values: npt.NDArray[np.int64] = table["label"].to_numpy().astype(np.int64)
        return values


def labelled(root: Path) -> list[int]:
    """Returns the trajectories that have labels, in order."""
    return [file.index for file in layout.numbered_files(root / _FOLDER)]


def save(root: Path, index: int, values: npt.NDArray[np.int64]) -> None:
    """Writes the labels of a trajectory, int64 (T,), durably."""
    sink = io.BytesIO()
    pq.write_table(pa.table({"label": pa.array(values, pa.int64())}), sink, write_page_checksum=True)
    write_atomic(layout.trajectory_path(root / _FOLDER, index), sink.getvalue())


def discard(root: Path, index: int) -> None:
    """Deletes the labels of a trajectory, if there are any."""
    layout.trajectory_path(root / _FOLDER, index).unlink(missing_ok=True)
