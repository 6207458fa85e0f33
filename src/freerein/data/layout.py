"""The on-disk format of a dataset, LeRobotDataset v3.0: its spec, file paths and columns. Opens no data file."""

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from freerein.data import json_files
from freerein.errors import InvalidInput, must_be
from freerein.types.common import ActionSpec, check_name

CODEBASE_VERSION = "v3.0"
CHUNK_SIZE = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
SPEC_FILE = "meta/freerein.json"
TASKS_FILE = "meta/tasks.parquet"
EPISODES_FILE = "meta/episodes/chunk-000/file-000.parquet"
STATS_FILE = "meta/stats.json"
INFO_FILE = "meta/info.json"
TEACHERS_FILE = "teachers.json"
STATE_KEY = "observation.state"
CAMERA_PREFIX = "observation.images."
TERMINATED_KEY = "next.terminated"
"""bool (T,); not LeRobot's `next.done`, which is also true where an episode was truncated."""

_INDEX_COLUMNS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
_LARGEST = float(np.finfo(np.float32).max)
_CHUNK = re.compile(r"chunk-(\d{3,})")
_FILE = re.compile(r"file-(\d{3,})\.parquet")


@dataclass(frozen=True)
class DatasetSpec:
    """Properties that all trajectories of a dataset share.

    Attributes:
        fps: Timesteps per second, a positive integer as LeRobot requires; see `integer_fps`.
        cameras: Frame size (H, W, C) in pixels by camera name, C = 1 or 3.
        action: Size of a continuous action, or number of choices of a discrete one; of size 0 where there are none.
        robot_type: Name of the robot.
        skills: Skill names; labels are indices into them. May be empty.
        task: Goal text of trajectories without one of their own.
        has_terminations: Whether every trajectory has `terminated`; otherwise none has.
        has_scaled_actions: Whether continuous actions are in [-1, 1]; otherwise they are in the robot's own unit.
        robot_state_size: Numbers of the robot's own state, such as joint positions; 0 where it is not kept.
        robot_state_names: Meaning of each of them; may be empty.
        control_dt_s: Time between two actions, in seconds, of which `fps` is the rounded inverse; 0 means 1 / fps.
    """

    fps: int
    cameras: dict[str, tuple[int, int, int]]
    action: ActionSpec
    robot_type: str
    skills: tuple[str, ...] = ()
    task: str = ""
    has_terminations: bool = False
    has_scaled_actions: bool = True
    robot_state_size: int = 0
    robot_state_names: tuple[str, ...] = ()
    control_dt_s: float = 0.0

    def __post_init__(self) -> None:
        """Raises InvalidInput where a value is out of range."""
        if self.fps < 1:
            raise must_be("fps", "a positive integer", self.fps)
        object.__setattr__(self, "control_dt_s", self.control_dt_s or 1 / self.fps)
        if integer_fps(self.control_dt_s) != self.fps:
            rule = f"a period of {self.fps} timesteps per second, rounded to an integer"
            raise must_be("control_dt_s", rule, f"{self.control_dt_s:g}")
        if not self.cameras:
            raise must_be("cameras", "at least one camera", "none")
        for name, (height, width, channels) in self.cameras.items():
            check_name(name, field="cameras")
            if height < 1 or width < 1 or channels not in (1, 3):
                found = f"({height}, {width}, {channels})"
                raise must_be("A camera's frames", "(H, W, C) with C = 1 or 3", found, field="cameras")
        if len(set(self.skills)) != len(self.skills) or "" in self.skills:
            raise must_be("skills", "different, non-empty names", "a repeated or empty one")
        if self.action.size < 0 or (self.action.choices and self.action.size != 1):
            found = f"{self.action.size} with {self.action.choices} choices"
            raise must_be("action", "exactly one number when it is discrete, else any number of them", found)
        if self.action.hold not in range(-1, self.action.choices):
            rule = f"one of {self.action.choices} choices, or -1 for none"
            raise must_be("action.hold", rule, self.action.hold)
        if self.robot_state_size < 0 or len(self.robot_state_names) not in (0, self.robot_state_size):
            found = f"{len(self.robot_state_names)} for {self.robot_state_size} numbers"
            raise must_be("robot_state_names", "a name for each number of the robot's state, or none", found)

    @property
    def has_actions(self) -> bool:
        """Whether timesteps have actions."""
        return self.action.size > 0

    @property
    def action_bounds(self) -> tuple[float, float]:
        """Least and greatest value of each number of an action, without bounds in the robot's own unit."""
        own_unit = not (self.has_scaled_actions or self.action.choices)
        return (-_LARGEST, _LARGEST) if own_unit else self.action.bounds

    @property
    def action_range(self) -> str:
        """The bounds in words, such as `finite and in [-1, 1]`."""
        low, high = self.action_bounds
        return "finite" if high == _LARGEST else f"finite and in [{low:g}, {high:g}]"


def integer_fps(control_dt_s: float) -> int:
    """Returns the timesteps per second of a control period, rounded to an integer.

    Raises:
        InvalidInput: The period is not between 0 (excluded) and 2 seconds.
    """
    if not 0 < control_dt_s < 2:
        hint = "A dataset needs a rate of at least one timestep per second."
        raise must_be("control_dt_s", "above 0 and below 2 seconds", control_dt_s, hint=hint)
    return round(1 / control_dt_s)


def dumps(spec: DatasetSpec) -> str:
    """Returns a spec as JSON, without later additions that say nothing, so that data files keep their bytes."""
    document = asdict(spec)
    if spec.control_dt_s == 1 / spec.fps:
        del document["control_dt_s"]
    if spec.action.hold == -1:
        del document["action"]["hold"]
    return json.dumps(document, indent=2)


def loads(text: str | bytes) -> DatasetSpec:
    """Parses JSON of `dumps`."""
    try:
        document = json_files.parse(text)
        action = document["action"]
        return DatasetSpec(
            fps=int(document["fps"]),
            cameras={name: (int(h), int(w), int(c)) for name, (h, w, c) in document["cameras"].items()},
            action=ActionSpec(
                size=int(action["size"]),
                choices=int(action["choices"]),
                names=tuple(action["names"]),
                unit=str(action["unit"]),
                scale=tuple(action["scale"]),
                absolute=bool(action.get("absolute", False)),  # missing before there were any
                hold=int(action.get("hold", -1)),
            ),
            robot_type=str(document["robot_type"]),
            skills=tuple(document["skills"]),
            task=str(document["task"]),
            has_terminations=bool(document.get("has_terminations", False)),  # missing before there were any
            has_scaled_actions=bool(document.get("has_scaled_actions", True)),  # likewise
            robot_state_size=int(document.get("robot_state_size", 0)),
            robot_state_names=tuple(document.get("robot_state_names", ())),
            control_dt_s=float(document.get("control_dt_s", 0.0)),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InvalidInput(
            "The dataset's description must be the JSON that freerein wrote; it cannot be read.",
            hint="Delete the dataset's meta folder: it is rebuilt from the data files.",
        ) from None


@dataclass(frozen=True)
class DataFile:
    """A complete data file: its path, the number of its folder and its own, and its size in bytes."""

    path: Path
    chunk: int
    file: int
    size: int

    @property
    def index(self) -> int:
        """Index of its trajectory, in a dataset written by freerein."""
        return self.chunk * CHUNK_SIZE + self.file


def dataset_path(data_dir: Path, name: str) -> Path:
    """Returns the path of a dataset; the only way from a request's text to the file system.

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
    """Returns the complete files below a folder such as `data`, in order; ignores all other files."""
    if not folder.is_dir():
        return []
    found = [
        DataFile(path, int(chunk[1]), int(file[1]), path.stat().st_size)
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
    """Returns the `features` of `info.json`: every column of a data file."""
    features: dict[str, dict[str, object]] = {
        camera_key(camera): {"dtype": "image", "shape": list(size), "names": ["height", "width", "channels"]}
        for camera, size in spec.cameras.items()
    }
    if spec.robot_state_size:
        state_names = list(spec.robot_state_names) or None
        features[STATE_KEY] = {"dtype": "float32", "shape": [spec.robot_state_size], "names": state_names}
    if spec.has_actions:
        names = list(spec.action.names) if len(spec.action.names) == spec.action.size else None
        features["action"] = {"dtype": str(spec.action.dtype), "shape": [spec.action.size], "names": names}
    for name, dtype in _number_columns(spec).items():
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
    return features


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
    """Returns the schema of a data file; an image is a struct of encoded bytes and an unused path."""
    image = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    state = [(STATE_KEY, _vector_type(np.dtype(np.float32), spec.robot_state_size))] if spec.robot_state_size else []
    action = [("action", _vector_type(spec.action.dtype, spec.action.size))] if spec.has_actions else []
    numbers = [(key, pa.from_numpy_dtype(dtype)) for key, dtype in _number_columns(spec).items()]
    images = ((camera_key(camera), image) for camera in spec.cameras)
    return pa.schema([*images, *state, *action, *numbers])


def _vector_type(dtype: np.dtype[Any], size: int) -> pa.DataType:
    """Returns LeRobot's type of a column of vectors: numbers where their size is 1, else lists."""
    number = pa.from_numpy_dtype(dtype)
    return number if size == 1 else pa.list_(number, size)


def _number_columns(spec: DatasetSpec) -> dict[str, str]:
    """Returns the dtype of every column of one number per timestep, besides the action."""
    return {TERMINATED_KEY: "bool", **_INDEX_COLUMNS} if spec.has_terminations else _INDEX_COLUMNS
