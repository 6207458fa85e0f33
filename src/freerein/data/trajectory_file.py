"""One trajectory as one parquet file, and the rows of a trajectory in any LeRobot data file.

The columns are LeRobot's. What LeRobot stores elsewhere (spec, goal text, skills, statistics) is repeated in the file's
footer under the key `freerein`, so that `meta/` can be rebuilt from the data files alone.
"""

import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias, cast

import numpy as np
import numpy.typing as npt
import PIL.Image
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from freerein import images
from freerein.atomic_files import write_atomic
from freerein.data import json_files, layout, statistics
from freerein.data.layout import DatasetSpec, dumps, loads
from freerein.data.statistics import FeatureStatistics
from freerein.errors import InvalidInput
from freerein.regular_files import open_regular
from freerein.types.common import Image, Trajectory

Actions: TypeAlias = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""float32 (T, A) in [-1, 1] where continuous, int64 (T, 1) where discrete."""

State: TypeAlias = npt.NDArray[np.float32]
"""The robot's own state, float32 (T, S), in units of its own."""

_FOOTER_KEY = b"freerein"
EPISODE, ORDER = "episode_index", "frame_index"
"""Columns of the numbers of episode and timestep."""

_GROUP_ROWS = 256  # so that a few frames of a long trajectory can be read
MOST_ROWS = 10_000_000
"""Most rows of a table that is read at once: repeated rows take no room in a file."""


@dataclass(frozen=True)
class TrajectoryFooter:
    """A data file's footer, with the statistics by feature; the goal text is empty where it is the spec's task."""

    spec: DatasetSpec
    length: int
    skills: tuple[str, ...]
    goal_text: str
    statistics: dict[str, FeatureStatistics]


def encode(
    trajectory: Trajectory,
    spec: DatasetSpec,
    *,
    index: int,
    first_frame: int,
    task_index: int,
    state: State | None = None,
) -> bytes:
    """Returns a trajectory as a parquet file; it must match the spec. The indices count within the dataset."""
    indices = _index_columns(trajectory, spec, index, first_frame, task_index)
    vectors: dict[str, npt.NDArray[Any]] = {layout.STATE_KEY: state} if state is not None else {}
    vectors |= {"action": trajectory.actions} if spec.has_actions else {}
    numbers = {**vectors, **{name: column[:, None] for name, column in indices.items()}}
    columns = {layout.camera_key(name): _image_column(trajectory.frames[name]) for name in spec.cameras}
    columns |= {name: _vector_column(values) for name, values in numbers.items()}
    found = {layout.camera_key(name): statistics.of_frames(trajectory.frames[name]) for name in spec.cameras}
    found |= {name: statistics.of_values(column) for name, column in numbers.items()}
    footer: dict[str, Any] = {
        "spec": json.loads(dumps(spec)),
        "skills": list(trajectory.skills),
        "goal_text": trajectory.goal_text,
        "statistics": {
            feature: {name: values.tolist() for name, values in each.items()} for feature, each in found.items()
        },
    }
    schema = layout.data_schema(spec).with_metadata({_FOOTER_KEY: json.dumps(footer).encode()})
    sink = io.BytesIO()
    # PNG bytes do not compress again, and column statistics of images would copy two of them into the footer.
    pq.write_table(
        pa.table(columns, schema=schema),
        sink,
        compression="none",
        use_dictionary=False,
        write_statistics=list(indices),
        write_page_checksum=True,
        row_group_size=_GROUP_ROWS,
    )
    return sink.getvalue()


def read_footer(file: BinaryIO, *, index: int) -> TrajectoryFooter | None:
    """Returns the footer of a trajectory's data file; None when freerein did not write the file."""
    with corrupt_as_invalid(f"Trajectory {index}"):
        metadata = pq.read_metadata(file)
        text = (metadata.metadata or {}).get(_FOOTER_KEY)
        if text is None:
            return None
        footer = json_files.parse(text)
        return TrajectoryFooter(
            spec=loads(json.dumps(footer["spec"])),
            length=metadata.num_rows,
            skills=tuple(footer["skills"]),
            goal_text=str(footer.get("goal_text", "")),
            statistics={
                feature: {name: np.array(values, np.float64) for name, values in each.items()}
                for feature, each in footer["statistics"].items()
            },
        )


def read_rows(paths: Sequence[Path], *, index: int, columns: Sequence[str]) -> pa.Table:
    """Returns the columns, and `episode_index`, of episode `index`, ordered by `frame_index`; files may hold others.

    Raises InvalidInput where a file is missing or corrupt, or timesteps are missing or there twice.
    """
    parts = [_rows_of(path, index, columns) for path in paths]
    with corrupt_as_invalid("The data file"):
        rows = pa.concat_tables(parts, promote_options="permissive") if len(parts) > 1 else parts[0]
        return _in_order(rows).select(list(dict.fromkeys([*columns, EPISODE]))).combine_chunks()


def _rows_of(path: Path, index: int, columns: Sequence[str]) -> pa.Table:
    """Returns the columns of an episode, and its `frame_index` where there is one, in the order of the file."""
    with corrupt_as_invalid("The data file"), open_regular(path, name=path.name) as file:
        parquet = pq.ParquetFile(file, page_checksum_verification=True)
        ranges = {group: episode_range(parquet, group) for group in range(parquet.num_row_groups)}
        groups = [group for group, (least, greatest) in ranges.items() if least <= index <= greatest]
        if sum(parquet.metadata.row_group(group).num_rows for group in groups) > MOST_ROWS:
            raise ValueError("too many rows")
        order = [ORDER] if ORDER in parquet.schema_arrow.names else []
        names = list(dict.fromkeys([*columns, *order, EPISODE]))
        table = parquet.read_row_groups(groups, columns=names, use_threads=False).select(names)
        return table.filter(pc.equal(table[EPISODE], index))


def _in_order(rows: pa.Table) -> pa.Table:
    """Returns rows in the order of their `frame_index`, which must count from 0; as they are where there is none."""
    if ORDER not in rows.column_names:
        return rows
    numbers = _flat(rows[ORDER]).to_numpy(zero_copy_only=False)
    expected = np.arange(len(rows))
    if np.array_equal(numbers, expected):
        return rows
    order = np.argsort(numbers, kind="stable")
    wrong = np.flatnonzero(numbers[order] != expected) if len(numbers) == len(rows) else expected
    if len(wrong):
        first = wrong[0]
        is_twice = first > 0 and numbers[order][first] == first - 1
        raise InvalidInput(
            f"Timesteps must have a `{ORDER}` from 0 on, each once; "
            f"{f'{first - 1} is there twice' if is_twice else f'{first} is missing'}.",
            hint="Record the trajectory again, or leave it out.",
        )
    return rows.take(order)


def decode_frames(rows: pa.Table, *, camera_key: str, size: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """Returns the frames of one camera, uint8 (T, H, W, C), from its column and of the required size (H, W, C)."""
    frames = np.empty((len(rows), *size), np.uint8)
    with corrupt_as_invalid(f"`{camera_key}`"):
        encoded = [record and record["bytes"] for record in rows[camera_key].to_pylist()]
    for t, data in enumerate(encoded):
        if not isinstance(data, bytes):
            raise InvalidInput(
                f"Every frame must be stored in the data file, as bytes; frame {t} is {type(data).__name__}.",
                hint="Export the dataset again with its images embedded.",
            )
        pixels = images.decode(Image(images.sniff(data, field="frames"), 0, 0, data), field="frames")
        if pixels.shape != size:
            raise InvalidInput(
                f"Every frame must have the size that the dataset declares, {size}; frame {t} has {pixels.shape}.",
                hint="Scale the frames to one size and record the dataset again.",
            )
        frames[t] = pixels
    return frames


def decode_actions(rows: pa.Table, spec: DatasetSpec, columns: Mapping[str, int]) -> Actions:
    """Returns the actions, float32 (T, A) or int64 (T, 1), of columns of these sizes; (T, 0) of a dataset without."""
    return cast(Actions, _joined(rows, columns).astype(spec.action.dtype))


def decode_state(rows: pa.Table, columns: Mapping[str, int]) -> State:
    """Returns the robot's own state, float32 (T, S), of columns of these sizes."""
    return _joined(rows, columns).astype(np.float32)


def decode_terminations(rows: pa.Table, *, key: str) -> npt.NDArray[np.bool_]:
    """Returns whether the episode terminated after each action, bool (T,), from its column."""
    flat = _flat(rows[key])
    if flat.type != pa.bool_() or flat.null_count or len(flat) != len(rows):
        raise InvalidInput(
            f"`{key}` must have one bool for each of the {len(rows)} timesteps; it has {len(flat) - flat.null_count} "
            "values, or others than bools.",
            hint="Record the trajectory again.",
        )
    terminated: npt.NDArray[np.bool_] = flat.to_numpy(zero_copy_only=False)
    return terminated


def write_labels(path: Path, labels: npt.NDArray[np.int64]) -> None:
    """Writes per-timestep labels, int64 (T,), durably."""
    sink = io.BytesIO()
    pq.write_table(pa.table({"label": pa.array(labels, pa.int64())}), sink, write_page_checksum=True)
    write_atomic(path, sink.getvalue())


def read_labels(path: Path, *, index: int) -> npt.NDArray[np.int64]:
    """Returns the per-timestep labels of trajectory `index`, int64 (T,)."""
    with corrupt_as_invalid(f"The labels of trajectory {index}"), open_regular(path, name=path.name) as file:
        parquet = pq.ParquetFile(file, page_checksum_verification=True)
        if parquet.metadata.num_rows > MOST_ROWS:
            raise ValueError("too many rows")
        table = parquet.read(use_threads=False)
        labels: npt.NDArray[np.int64] = table["label"].to_numpy().astype(np.int64)
        return labels


@contextmanager
def corrupt_as_invalid(subject: str) -> Iterator[None]:
    """Raises InvalidInput where the body fails to read a parquet or JSON file."""
    try:
        yield
    except (pa.ArrowException, OSError, ArithmeticError, LookupError, TypeError, ValueError):
        raise InvalidInput(
            f"{subject} must be a whole file with the contents that LeRobot's format names; "
            "it is missing, truncated or corrupt.",
            hint="`freerein dataset verify NAME`, or FOLDER, lists all that is broken: restore it from a copy.",
        ) from None


def _flat(column: pa.ChunkedArray) -> pa.Array:
    """Returns the numbers of a column, of lists or of numbers, as one array."""
    joined = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
    is_list = pa.types.is_list(joined.type) or pa.types.is_fixed_size_list(joined.type)
    flat = joined.flatten() if is_list or pa.types.is_large_list(joined.type) else joined
    if not (pa.types.is_integer(flat.type) or pa.types.is_floating(flat.type) or pa.types.is_boolean(flat.type)):
        raise InvalidInput(
            "A column of numbers must have numbers, or lists of them; this one has others.",
            hint="Write the dataset again with LeRobot.",
        )
    return flat


def _joined(rows: pa.Table, columns: Mapping[str, int]) -> npt.NDArray[Any]:
    """Returns columns of vectors of these sizes side by side, (T, D)."""
    parts: list[npt.NDArray[Any]] = [np.empty((len(rows), 0), np.int64)]
    for key, size in columns.items():
        flat = _flat(rows[key])
        if flat.null_count or len(flat) != len(rows) * size:
            raise InvalidInput(
                f"Every timestep must have {size} numbers in `{key}`; the data file holds "
                f"{len(flat) - flat.null_count} for {len(rows)} timesteps.",
                hint="Record the trajectory again.",
            )
        parts.append(flat.to_numpy(zero_copy_only=False).reshape(len(rows), size))
    return np.concatenate(parts[1:] or parts, axis=1)


def episode_ranges(path: Path) -> list[tuple[float, float]]:
    """Returns the least and greatest episode of each row group of a data file, by its footer; none of a corrupt one."""
    try:
        with open_regular(path, name=path.name) as file:
            parquet = pq.ParquetFile(file)
            return [episode_range(parquet, group) for group in range(parquet.num_row_groups)]
    except (pa.ArrowException, OSError, ValueError, InvalidInput):
        return []


def episode_range(parquet: pq.ParquetFile, group: int) -> tuple[float, float]:
    """Returns the least and greatest episode of a row group, by its statistics where it has them."""
    position = parquet.schema.names.index(EPISODE)
    bounds = parquet.metadata.row_group(group).column(position).statistics
    is_known = bounds is not None and bounds.has_min_max and isinstance(bounds.min, int)
    return (bounds.min, bounds.max) if is_known else (-math.inf, math.inf)


def _index_columns(
    trajectory: Trajectory, spec: DatasetSpec, index: int, first_frame: int, task_index: int
) -> dict[str, npt.NDArray[Any]]:
    """Returns the columns of one number per timestep, (T,): terminations, if known, and LeRobot's indices."""
    t = np.arange(len(trajectory.actions))
    terminated = {} if trajectory.terminated is None else {layout.TERMINATED_KEY: trajectory.terminated}
    return {
        **terminated,
        "timestamp": (t / spec.fps).astype(np.float32),
        "frame_index": t,
        "episode_index": np.full_like(t, index),
        "index": first_frame + t,
        "task_index": np.full_like(t, task_index),
    }


def _image_column(frames: npt.NDArray[np.uint8]) -> pa.Array:
    encoded = pa.array([_png(frame) for frame in frames], pa.binary())
    return pa.StructArray.from_arrays([encoded, pa.nulls(len(encoded), pa.string())], names=["bytes", "path"])


def _png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Encodes at compression level 1: recording must keep up with the simulator."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _vector_column(vectors: npt.NDArray[Any]) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(vectors).ravel())
    return flat if vectors.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, vectors.shape[1])
