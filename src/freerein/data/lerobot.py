"""Reads the metadata of LeRobotDataset v3 datasets of other tools, of images or video.

Depth cameras are left out. Continuous actions may be in any unit, or missing. `observation.state` is read where it is a
vector of floats; other observations are left out.

Terminations are those of `next.terminated`, else of LeRobot's own `next.done`: true at the end of an episode, for most
tools that write it also where the episode was truncated.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.data import layout
from freerein.data.layout import DatasetSpec
from freerein.data.trajectory_file import corrupt_as_invalid
from freerein.data.videos import VideoSpan, check_length
from freerein.errors import InvalidInput, NotFound
from freerein.types.common import ActionSpec

_EPISODE_COLUMNS = ["episode_index", "length", "data/chunk_index", "data/file_index"]
_VIDEO_COLUMNS = {"chunk_index": pa.int64(), "file_index": pa.int64(), "from_timestamp": pa.float64()}
_END_COLUMN = "to_timestamp"


@dataclass(frozen=True)
class LeRobotMeta:
    """Metadata of a dataset that another tool wrote.

    Attributes:
        spec: Properties that the trajectories share.
        episodes: One row per trajectory: `length`, `data/chunk_index`, `data/file_index`, `tasks`, `skills`.
        camera_keys: The column of the frames, by camera whose frames are images.
        videos: Where each trajectory's frames lie, by camera whose frames are video.
        terminated_key: The column of the terminations.
    """

    spec: DatasetSpec
    episodes: pa.Table
    camera_keys: dict[str, str]
    videos: dict[str, tuple[VideoSpan, ...]]
    terminated_key: str


def read(root: Path) -> LeRobotMeta:
    """Returns the metadata of the dataset in a folder.

    Raises:
        NotFound: There is no dataset.
        InvalidInput: It is not a supported LeRobotDataset v3: other version, unsupported action, or corrupt.
    """
    info = _read_json(root / layout.INFO_FILE)
    if info is None:
        raise NotFound(
            "There must be a dataset of this name; there is none.",
            hint="`freerein dataset list` names those that there are.",
        )
    try:
        _check_layout(info)
        images, videos = (_camera_keys(info["features"], dtype=dtype) for dtype in ("image", "video"))
        keys = images | videos
        terminated_key, stored = _terminated_key(info["features"]), _stored_episodes(root)
        episodes = _with_lists(stored)
        state_size, state_names = _robot_state(info["features"].get(layout.STATE_KEY))
        spec = DatasetSpec(
            fps=int(info["fps"]),
            cameras={camera: _frame_size(info["features"][key]) for camera, key in keys.items()},
            action=_action(info["features"].get("action"), root),
            robot_type=str(info.get("robot_type") or ""),
            skills=tuple(sorted({skill for skills in episodes["skills"].to_pylist() for skill in skills})),
            task=_task(root),
            has_terminations=bool(terminated_key),
            has_scaled_actions=False,
            robot_state_size=state_size,
            robot_state_names=state_names,
        )
        spans = {camera: _spans(root, stored, key, fps=spec.fps) for camera, key in videos.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        raise InvalidInput(
            "`info.json` must describe at least one camera, and any action, as LeRobot v3.0 does; it does not.",
            hint="Open the dataset in LeRobot to see what it lacks.",
        ) from None
    return LeRobotMeta(spec, episodes, images, spans, terminated_key)


def _check_layout(info: dict[str, Any]) -> None:
    if not str(info["codebase_version"]).startswith("v3."):
        raise InvalidInput(
            "The dataset must be a LeRobotDataset v3; it is of another version.",
            hint="Convert it with LeRobot's script convert_dataset_v21_to_v30.",
        )
    has_own_paths = info["data_path"] != layout.DATA_PATH or info.get("video_path") not in (None, layout.VIDEO_PATH)
    if has_own_paths or info["fps"] != int(info["fps"]):
        raise InvalidInput(
            "The dataset must keep LeRobot's own data and video paths, and an integer fps; it does not.",
            hint="Write it again with LeRobotDataset.create.",
        )


def _camera_keys(features: dict[str, Any], *, dtype: str) -> dict[str, str]:
    """Returns the features of the cameras whose frames are `image` or `video`, by camera, in lower case."""
    keys = [key for key, feature in features.items() if feature["dtype"] == dtype and not _is_depth(feature)]
    return {key.removeprefix(layout.CAMERA_PREFIX).removeprefix("observation.").lower(): key for key in keys}


def _is_depth(feature: dict[str, Any]) -> bool:
    info = feature.get("info") or feature.get("video_info") or {}
    return any(name.endswith("is_depth_map") and bool(value) for name, value in info.items())


def _spans(root: Path, episodes: pa.Table, key: str, *, fps: int) -> tuple[VideoSpan, ...]:
    """Returns where the frames of each trajectory lie, by the table of the episodes."""
    with corrupt_as_invalid("`meta/episodes`"):
        names = [*_VIDEO_COLUMNS, _END_COLUMN]
        columns = [episodes[f"videos/{key}/{name}"].cast(_VIDEO_COLUMNS.get(name, pa.float64())) for name in names]
        rows = list(zip(*(column.to_pylist() for column in (*columns, episodes["length"])), strict=True))
        files = [layout.VIDEO_PATH.format(video_key=key, chunk_index=row[0], file_index=row[1]) for row in rows]
        spans = [VideoSpan(root, file, row[2], row[4]) for file, row in zip(files, rows, strict=True)]
    return tuple(
        check_length(span, row[3], index=index, fps=fps)
        for index, (span, row) in enumerate(zip(spans, rows, strict=True))
    )


def _terminated_key(features: dict[str, Any]) -> str:
    """Returns the column of the terminations; empty where there is none."""
    bools = [key for key, feature in features.items() if feature["dtype"] == "bool" and feature["shape"] == [1]]
    return next((key for key in (layout.TERMINATED_KEY, "next.done") if key in bools), "")


def _frame_size(feature: dict[str, Any]) -> tuple[int, int, int]:
    """Returns (H, W, C), also where the axes are declared in another order."""
    shape, names = feature["shape"], feature["names"] or ["height", "width", "channels"]
    by_axis = {str(name)[:1]: int(length) for name, length in zip(names, shape, strict=True)}
    return by_axis["h"], by_axis["w"], by_axis["c"]


def _action(feature: dict[str, Any] | None, root: Path) -> ActionSpec:
    if feature is None:
        return ActionSpec(size=0, choices=0, names=())
    shape, dtype = feature["shape"], feature["dtype"]
    if dtype == "int64" and shape == [1]:
        return ActionSpec(size=1, choices=_choices(root), names=())
    if not dtype.startswith("float") or len(shape) != 1:
        raise InvalidInput(
            "An action must be a vector of floats, or one int64; this dataset has another kind.",
            hint="Convert the action before recording.",
        )
    return ActionSpec(size=int(shape[0]), choices=0, names=_flat_names(feature.get("names"), int(shape[0])))


def _robot_state(feature: dict[str, Any] | None) -> tuple[int, tuple[str, ...]]:
    """Returns the size of the robot's own state and the names of its numbers; 0 where it is no vector of floats."""
    if feature is None or not feature["dtype"].startswith("float") or len(feature["shape"]) != 1:
        return 0, ()
    size = int(feature["shape"][0])
    return size, _flat_names(feature.get("names"), size)


def _choices(root: Path) -> int:
    """Returns the number of discrete actions: one more than the largest that occurs."""
    stats = _read_json(root / layout.STATS_FILE) or {}
    return int(np.max(stats["action"]["max"])) + 1


def _flat_names(names: object, size: int) -> tuple[str, ...]:
    """LeRobot allows a list of names, or lists of names by group."""
    groups = names.values() if isinstance(names, dict) else [names]
    flat = tuple(str(name) for group in groups if isinstance(group, list) for name in group)
    return flat if len(flat) == size else ()


def _task(root: Path) -> str:
    """Returns the task's text; empty when the trajectories are of several tasks."""
    with corrupt_as_invalid("`tasks.parquet`"):
        table = pq.read_table(root / layout.TASKS_FILE, use_threads=False)
        named = table.select(["task"] if "task" in table.column_names else table.column_names)
        texts = next((column.to_pylist() for column in named.columns if _is_text(column.type)), None)
    if texts is None:
        raise InvalidInput(
            "`tasks.parquet` must have the texts of the tasks in a column `task`; it has no such texts.",
            hint="Write it again with LeRobot.",
        )
    return str(texts[0] or "") if len(texts) == 1 else ""


def _is_text(kind: pa.DataType) -> bool:
    """Returns whether a column holds texts, in whichever way: pandas, since version 3, has others than before."""
    values = kind.value_type if pa.types.is_dictionary(kind) else kind
    return values in (pa.string(), pa.large_string(), pa.string_view())


def _stored_episodes(root: Path) -> pa.Table:
    folder = root / "meta" / "episodes"
    with corrupt_as_invalid("`meta/episodes`"):
        paths = [layout.numbered(folder, chunk=f.chunk, file=f.file) for f in layout.numbered_files(folder)]
        tables = [pq.read_table(path, use_threads=False) for path in paths]
        joined = pa.concat_tables(tables, promote_options="permissive").sort_by("episode_index")
        for name in _EPISODE_COLUMNS:
            joined = joined.set_column(joined.schema.get_field_index(name), name, joined[name].cast(pa.int64()))
        return joined


def _with_lists(table: pa.Table) -> pa.Table:
    """Returns the columns used here; tasks and skills are empty lists where their column is missing."""
    chosen, strings = table.select(_EPISODE_COLUMNS), pa.list_(pa.string())
    with corrupt_as_invalid("`meta/episodes`"):
        for name in ("tasks", "skills"):
            lists = table[name].to_pylist() if name in table.column_names else [None] * len(table)
            chosen = chosen.append_column(name, pa.array([each or [] for each in lists], strings))
    return chosen


def _read_json(path: Path) -> dict[str, Any] | None:
    with corrupt_as_invalid(f"`{path.name}`"):
        return dict(json.loads(path.read_text())) if path.is_file() else None
