"""Where things lie in a dataset, and how LeRobotDataset v3.0 describes them. Nothing here touches file contents."""

import re
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from freerein.data.spec import DatasetSpec
from freerein.types.common import check_name

CODEBASE_VERSION = "v3.0"
CHUNK_SIZE = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
SPEC_FILE = "meta/freerein.json"
TASKS_FILE = "meta/tasks.parquet"
EPISODES_FILE = "meta/episodes/chunk-000/file-000.parquet"
STATS_FILE = "meta/stats.json"
INFO_FILE = "meta/info.json"
CAMERA_PREFIX = "observation.images."

_BOOKKEEPING = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
_CHUNK = re.compile(r"chunk-(\d{3,})")
_FILE = re.compile(r"file-(\d{3,})\.parquet")


@dataclass(frozen=True)
class DataFile:
    """A finished data file.

    Attributes:
        chunk: Number of its folder.
        file: Its number in the folder.
        size: Its length in bytes.
    """

    chunk: int
    file: int
    size: int

    @property
    def index(self) -> int:
        """The trajectory that it holds, in a dataset written by freerein."""
        return self.chunk * CHUNK_SIZE + self.file


def dataset_path(data_dir: Path, name: str) -> Path:
    """Returns where the dataset of a name lies: the only way from a request's text to the file system.

    Raises:
        InvalidInput: `name` does not match `^[a-z0-9][a-z0-9._-]{0,63}$`.
    """
    return data_dir / "datasets" / check_name(name, field="dataset")


def numbered(folder: Path, *, chunk: int, file: int) -> Path:
    """Returns the path of a numbered file below a folder such as `data`."""
    return folder / f"chunk-{chunk:03d}" / f"file-{file:03d}.parquet"


def trajectory_path(folder: Path, index: int) -> Path:
    """Returns the path of trajectory `index` below `data` or a folder laid out like it."""
    return numbered(folder, chunk=index // CHUNK_SIZE, file=index % CHUNK_SIZE)


def numbered_files(folder: Path) -> list[DataFile]:
    """Returns the finished files below a folder such as `data`, in order; unfinished and foreign ones are not seen."""
    if not folder.is_dir():
        return []
    found = [
        DataFile(int(chunk[1]), int(file[1]), path.stat().st_size)
        for directory in folder.iterdir()
        if (chunk := _CHUNK.fullmatch(directory.name))
        for path in directory.iterdir()
        if (file := _FILE.fullmatch(path.name))
    ]
    return sorted(found, key=lambda each: (each.chunk, each.file))


def camera_key(camera: str) -> str:
    """Returns the LeRobot feature that holds a camera's frames."""
    return CAMERA_PREFIX + camera


def features(spec: DatasetSpec) -> dict[str, dict[str, object]]:
    """Returns `info.json`'s description of every column of a data file."""
    described: dict[str, dict[str, object]] = {
        camera_key(camera): {"dtype": "image", "shape": list(size), "names": ["height", "width", "channels"]}
        for camera, size in spec.cameras.items()
    }
    names = list(spec.action.names) if len(spec.action.names) == spec.action.size else None
    described["action"] = {"dtype": str(spec.action_dtype), "shape": [spec.action.size], "names": names}
    for name, dtype in _BOOKKEEPING.items():
        described[name] = {"dtype": dtype, "shape": [1], "names": None}
    return described


def info(spec: DatasetSpec, *, trajectories: int, frames: int, tasks: int) -> dict[str, object]:
    """Returns the contents of `info.json`."""
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": spec.robot_type,
        "total_episodes": trajectories,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK_SIZE,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": spec.fps,
        "splits": {"train": f"0:{trajectories}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": features(spec),
    }


def data_schema(spec: DatasetSpec) -> pa.Schema:
    """Returns the columns of a data file; an image is a struct of encoded bytes and an unused path."""
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    number = pa.from_numpy_dtype(spec.action_dtype)
    action = number if spec.action.size == 1 else pa.list_(number, spec.action.size)
    bookkeeping = [(key, pa.from_numpy_dtype(dtype)) for key, dtype in _BOOKKEEPING.items()]
    return pa.schema([*((camera_key(camera), image) for camera in spec.cameras), ("action", action), *bookkeeping])
