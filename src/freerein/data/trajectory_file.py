"""One trajectory as one parquet file that describes itself: `meta/` can be rebuilt from such files alone.

The columns are LeRobot's. What LeRobot keeps elsewhere (the dataset's spec, the trajectory's goal text, skills and
statistics) also stands in the file's footer, under the key `freerein`.
"""

import io
import json
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import PIL.Image
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.data import layout, statistics
from freerein.data.rows import refusing_corruption
from freerein.data.spec import DatasetSpec, dumps, loads
from freerein.data.statistics import FeatureStatistics
from freerein.types.common import Trajectory

_FOOTER_KEY = b"freerein"


@dataclass(frozen=True)
class Footer:
    """What a data file says of itself.

    Attributes:
        spec: The dataset's spec.
        length: Timesteps, T.
        skills: The set of skills that occur, sorted.
        goal_text: What was to be done, in words; empty where the spec says it.
        statistics: By feature.
    """

    spec: DatasetSpec
    length: int
    skills: tuple[str, ...]
    goal_text: str
    statistics: dict[str, FeatureStatistics]


def encode(trajectory: Trajectory, spec: DatasetSpec, *, index: int, first_frame: int, task_index: int) -> bytes:
    """Returns a trajectory as a parquet file.

    Args:
        trajectory: As the spec says; not checked here.
        spec: The dataset's spec.
        index: Number of the trajectory in the dataset.
        first_frame: Number of its first frame in the dataset.
        task_index: Number of its goal text among those of the dataset.
    """
    numbers = _numbers(trajectory, spec, index, first_frame, task_index)
    columns = {layout.camera_key(name): _image_column(trajectory.frames[name]) for name in spec.cameras}
    columns["action"] = _action_column(trajectory.actions)
    columns |= {name: pa.array(column[:, 0]) for name, column in numbers.items() if name != "action"}
    described: dict[str, Any] = {
        "spec": json.loads(dumps(spec)),
        "skills": list(trajectory.skills),
        "goal_text": trajectory.goal_text,
        "statistics": {name: _as_lists(each) for name, each in _statistics(trajectory, spec, numbers).items()},
    }
    schema = layout.data_schema(spec).with_metadata({_FOOTER_KEY: json.dumps(described).encode()})
    sink = io.BytesIO()
    # PNG bytes do not compress again, and column statistics of images would copy two of them into the footer.
    pq.write_table(
        pa.table(columns, schema=schema),
        sink,
        compression="none",
        use_dictionary=False,
        write_statistics=[name for name in numbers if name != "action"],
        write_page_checksum=True,
    )
    return sink.getvalue()


def read_footer(file: BinaryIO, *, index: int) -> Footer | None:
    """Returns what the data file of trajectory `index` says of itself, None when freerein did not write it.

    Raises:
        InvalidInput: The file is truncated or corrupt.
    """
    with refusing_corruption(f"Trajectory {index}"):
        metadata = pq.read_metadata(file)
        text = (metadata.metadata or {}).get(_FOOTER_KEY)
        if text is None:
            return None
        described = json.loads(text)
        return Footer(
            spec=loads(json.dumps(described["spec"])),
            length=metadata.num_rows,
            skills=tuple(described["skills"]),
            goal_text=str(described.get("goal_text", "")),
            statistics={name: _as_arrays(each) for name, each in described["statistics"].items()},
        )


def _numbers(
    trajectory: Trajectory, spec: DatasetSpec, index: int, first_frame: int, task_index: int
) -> dict[str, npt.NDArray[Any]]:
    """Every column but the images: (T, A) actions, and the (T, 1) that LeRobot wants beside them."""
    t = np.arange(len(trajectory.actions))
    columns: dict[str, npt.NDArray[Any]] = {
        "timestamp": (t / spec.fps).astype(np.float32),
        "frame_index": t,
        "episode_index": np.full_like(t, index),
        "index": first_frame + t,
        "task_index": np.full_like(t, task_index),
    }
    return {"action": trajectory.actions, **{name: column[:, None] for name, column in columns.items()}}


def _statistics(
    trajectory: Trajectory, spec: DatasetSpec, numbers: dict[str, npt.NDArray[Any]]
) -> dict[str, FeatureStatistics]:
    of_cameras = {layout.camera_key(name): statistics.of_frames(trajectory.frames[name]) for name in spec.cameras}
    return of_cameras | {name: statistics.of_values(column) for name, column in numbers.items()}


def _image_column(frames: npt.NDArray[np.uint8]) -> pa.Array:
    encoded = pa.array([_png(frame) for frame in frames], pa.binary())
    return pa.StructArray.from_arrays([encoded, pa.nulls(len(encoded), pa.string())], names=["bytes", "path"])


def _png(pixels: npt.NDArray[np.uint8]) -> bytes:
    """Compresses at level 1: recording must keep up with the simulator."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _action_column(actions: npt.NDArray[Any]) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(actions).ravel())
    return flat if actions.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, actions.shape[1])


def _as_lists(of_feature: FeatureStatistics) -> dict[str, list[Any]]:
    return {name: values.tolist() for name, values in of_feature.items()}


def _as_arrays(of_feature: dict[str, list[Any]]) -> FeatureStatistics:
    return {name: np.array(values, np.float64) for name, values in of_feature.items()}
