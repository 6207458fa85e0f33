"""Ground truth for evaluation only: per-timestep skill labels beside a dataset, never in it.

    <root>/truth/chunk-000/file-000.parquet    the labels of data/chunk-000/file-000.parquet

Learners read with `freerein.data.reader`, which does not import this module.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data import layout
from freerein.data.trajectory_file import read_labels, write_labels
from freerein.errors import NotFound

_FOLDER = "truth"


def labels(root: Path, index: int) -> npt.NDArray[np.int64]:
    """Returns the true skill at each timestep of a trajectory.

    Returns:
        int64 (T,), indices into the `skills` of the dataset's spec; -1 where people labelled a part of it.

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
    return read_labels(path, index=index)


def labelled(root: Path) -> list[int]:
    """Returns the indices of the trajectories that have labels, in order."""
    return [index for index in stored(root) if layout.trajectory_path(root / "data", index).is_file()]


def stored(root: Path) -> list[int]:
    """Returns the indices of all labels, in order, also of those whose trajectory is still to be written, or never was.

    A recording stores the labels of a trajectory before the trajectory, and may be killed in between.
    """
    return [file.index for file in layout.numbered_files(root / _FOLDER)]


def save(root: Path, index: int, values: npt.NDArray[np.int64]) -> None:
    """Writes the labels of a trajectory, int64 (T,), durably."""
    write_labels(layout.trajectory_path(root / _FOLDER, index), values)


def discard(root: Path, index: int) -> None:
    """Deletes the labels of a trajectory, if any."""
    layout.trajectory_path(root / _FOLDER, index).unlink(missing_ok=True)
