"""The rows of one trajectory out of a data file, whoever wrote it, and what they decode to."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from freerein import images
from freerein.data.spec import DatasetSpec
from freerein.errors import InvalidInput
from freerein.types.common import Image

Actions: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""float32 (T, A) in [-1, 1] where continuous, int64 (T, 1) where discrete."""


def read_rows(path: Path, *, index: int, columns: list[str]) -> pa.Table:
    """Returns the rows of one trajectory, alone in its file or not.

    Args:
        path: The data file.
        index: The trajectory's number in the dataset.
        columns: Names of the columns wanted; `episode_index` comes with them.

    Raises:
        InvalidInput: The file is missing, truncated or corrupt, or lacks a column.
    """
    with refusing_corruption(f"Trajectory {index}"), path.open("rb") as file:
        parquet = pq.ParquetFile(file, page_checksum_verification=True)
        groups = [group for group in range(parquet.num_row_groups) if _may_hold(parquet, group, index)]
        table = parquet.read_row_groups(groups, columns=[*columns, "episode_index"], use_threads=False)
        return table.filter(pc.equal(table["episode_index"], index)).combine_chunks()


def decode_frames(rows: pa.Table, *, camera_key: str, size: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """Returns the frames of one camera.

    Args:
        rows: From `read_rows`.
        camera_key: The column.
        size: (H, W, C) that every frame must have.

    Returns:
        uint8 (T, H, W, C).

    Raises:
        InvalidInput: A frame is missing, corrupt or of another size.
    """
    frames = np.empty((len(rows), *size), np.uint8)
    for t, record in enumerate(rows[camera_key].to_pylist()):
        if record is None or record["bytes"] is None:
            raise InvalidInput(
                f"Every frame must be stored in the data file; frame {t} is not.",
                hint="Export the dataset again with its images embedded.",
            )
        pixels = images.decode(Image(images.sniff(record["bytes"]), 0, 0, record["bytes"]), field="frames")
        if pixels.shape != size:
            raise InvalidInput(
                f"Every frame must have the size that the dataset declares, {size}; frame {t} has {pixels.shape}.",
                hint="Scale the frames to one size and record the dataset again.",
            )
        frames[t] = pixels
    return frames


def decode_actions(rows: pa.Table, spec: DatasetSpec) -> Actions:
    """Returns the actions, float32 (T, A) or int64 (T, 1).

    Args:
        rows: From `read_rows`.
        spec: The dataset's spec.

    Raises:
        InvalidInput: A timestep has no action, or one of another size.
    """
    column = pa.concat_arrays(rows["action"].chunks) if rows["action"].num_chunks else pa.array([], pa.float32())
    flat = column.flatten() if pa.types.is_nested(column.type) else column
    if flat.null_count or len(flat) != len(rows) * spec.action.size:
        raise InvalidInput(
            f"Every timestep must have an action of {spec.action.size} numbers; the data file holds "
            f"{len(flat) - flat.null_count} for {len(rows)} timesteps.",
            hint="Record the trajectory again.",
        )
    actions: Actions = flat.to_numpy(zero_copy_only=False).astype(spec.action_dtype)
    return actions.reshape(len(rows), spec.action.size)


@contextmanager
def refusing_corruption(subject: str) -> Iterator[None]:
    """Turns whatever parquet says of a broken file into one sentence of ours.

    Raises:
        InvalidInput: The body met a broken file.
    """
    try:
        yield
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError):
        raise InvalidInput(
            f"{subject} must be a whole file with the contents that LeRobot's format names; "
            "it is missing, truncated or corrupt.",
            hint="Run `freerein dataset verify` to see which files are broken, and restore those from a copy.",
        ) from None


def _may_hold(parquet: pq.ParquetFile, group: int, index: int) -> bool:
    """Whether a row group may hold rows of a trajectory, by the group's own statistics where it has them."""
    position = parquet.schema.names.index("episode_index")
    bounds = parquet.metadata.row_group(group).column(position).statistics
    return bounds is None or not bounds.has_min_max or bool(bounds.min <= index <= bounds.max)
