"""Whether frames show the goal of their trajectory, as a reward model judges them, beside a dataset. Learners read it.

    <root>/reached/chunk-000/file-000.parquet    the judgements of data/chunk-000/file-000.parquet

Who records the trajectories writes them, before the dataset is published.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data import layout
from freerein.data.trajectory_file import read_labels, write_labels
from freerein.errors import InvalidInput

FOLDER = "reached"
"""Name of their folder, in that of the dataset."""

Flags = npt.NDArray[np.bool_]


def save(root: Path, index: int, flags: Flags) -> None:
    """Writes the judgements of a trajectory's frames, bool (T,), durably."""
    write_labels(layout.trajectory_path(root / FOLDER, index), flags.astype(np.int64))


def read(root: Path, lengths: npt.NDArray[np.int64]) -> tuple[Flags, ...]:
    """Returns the judgements of the frames of every trajectory, bool (T,) each; empty of a dataset without.

    Args:
        root: The dataset's folder.
        lengths: Timesteps of each trajectory, int64 (n,).

    Raises:
        InvalidInput: Some of them are missing, corrupt, or of another length.
    """
    if not (root / FOLDER).is_dir():
        return ()
    found = [read_labels(layout.trajectory_path(root / FOLDER, index), index=index) for index in range(len(lengths))]
    for index, (values, length) in enumerate(zip(found, lengths.tolist(), strict=True)):
        if len(values) != length or not np.isin(values, (0, 1)).all():
            raise InvalidInput(
                f"Whether each of the {length} frames of trajectory {index} shows its goal must be known, as 0 or 1; "
                f"got {len(values)} numbers, {int(np.sum(~np.isin(values, (0, 1))))} of them others.",
                field="dataset",
                hint="Record the dataset again, or restore its folder `reached` from a copy.",
            )
    return tuple(values == 1 for values in found)
