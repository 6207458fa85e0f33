"""Reads the metadata of LeRobotDataset v3 datasets of other tools, of images or video.

Cameras that cannot be read are left out, such as depth maps. Continuous actions may be in any unit, or missing.
`observation.state` is read where it is a vector of floats, other observations are not; `LeRobotOptions` names others.

Terminations are those of `next.terminated`, else of LeRobot's own `next.done`: true at the end of an episode, for most
tools that write it also where the episode was truncated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from freerein.data import json_files, layout, lerobot_features, lerobot_tables
from freerein.data.layout import DatasetSpec
from freerein.data.lerobot_features import DEFAULTS, Features, LeRobotOptions, Vector
from freerein.data.trajectory_file import corrupt_as_invalid
from freerein.data.videos import VideoSpan
from freerein.errors import InvalidInput, NotFound, must_be, quoted
from freerein.types.common import ActionSpec

_HIGHEST_FPS = 1000
_MOST_CHOICES = 10_000


@dataclass(frozen=True)
class LeRobotMeta:
    """The features that are read of a dataset, and their files.

    Attributes:
        spec: Properties that the trajectories share.
        episodes: One row per trajectory: `episode_index`, `length`, `data/chunk_index`, `data/file_index`, `tasks`,
            `skills`.
        camera_keys: The column of the frames, by camera whose frames are images.
        videos: Where each trajectory's frames lie, by camera whose frames are video.
        action_columns: The size of each column of the action.
        state_columns: The size of each column of the robot's state.
        terminated_key: The column of the terminations; empty for none.
        left_out: Why each feature is not read that is not, by its name.
    """

    spec: DatasetSpec
    episodes: pa.Table
    camera_keys: Mapping[str, str]
    action_columns: Mapping[str, int]
    state_columns: Mapping[str, int]
    terminated_key: str
    videos: Mapping[str, tuple[VideoSpan, ...]] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)


def read(root: Path, options: LeRobotOptions = DEFAULTS) -> LeRobotMeta:
    """Returns the metadata of the dataset in a folder.

    Raises:
        NotFound: There is no dataset.
        InvalidInput: It is not a supported LeRobotDataset v3: other version, unsupported action, or corrupt.
    """
    info = read_info(root)
    described = lerobot_features.described(info.get("features"))
    videos = [key for key, feature in described.items() if feature.get("dtype") == "video"]
    episodes, damaged = lerobot_tables.read_episodes(root, videos, skip_damaged=options.skip_damaged)
    unlocated = [key for key in videos if not lerobot_tables.has_video(episodes, key)]
    features = lerobot_features.choose(described, options, unlocated=unlocated)
    if options.skip_damaged:
        episodes, contradicting = _consistent(root, episodes, features, fps=fps_of(info))
        damaged |= contradicting
    damaged |= _uncounted(info, len(episodes))
    tasks = lerobot_tables.read_texts(root, layout.TASKS_FILE, "task")
    spec = DatasetSpec(
        fps=fps_of(info),
        cameras={name: camera.size for name, camera in features.cameras.items()},
        action=_action(root, features.action),
        robot_type=str(info.get("robot_type") or ""),
        skills=tuple(sorted({skill for skills in episodes["skills"].to_pylist() for skill in skills})),
        task=next(iter(tasks.values())) if len(tasks) == 1 else "",
        has_terminations=bool(features.terminated),
        has_scaled_actions=False,
        robot_state_size=features.state.size,
        robot_state_names=features.state.names,
    )
    return LeRobotMeta(
        spec=spec,
        episodes=episodes,
        camera_keys={name: camera.key for name, camera in features.cameras.items() if not camera.is_video},
        videos={
            name: lerobot_tables.video_spans(root, episodes, camera.key, fps=spec.fps)
            for name, camera in features.cameras.items()
            if camera.is_video
        },
        action_columns=features.action.columns,
        state_columns=features.state.columns,
        terminated_key=features.terminated,
        left_out={**features.left_out, **damaged},
    )


def _uncounted(info: Mapping[str, Any], listed: int) -> dict[str, str]:
    """Returns that another number of episodes is counted than listed, by the name of the count."""
    counted = info.get("total_episodes", listed)
    found = counted if isinstance(counted, int) else "no number"
    reason = f"`info.json` counts {found}, `meta/episodes` lists {listed}"
    return {"total_episodes": reason} if counted != listed else {}


def _consistent(root: Path, episodes: pa.Table, features: Features, *, fps: int) -> tuple[pa.Table, dict[str, str]]:
    """Returns the episodes that last as long in their videos as in timesteps, and why the others are left out."""
    keys = [camera.key for camera in features.cameras.values() if camera.is_video]
    wrong = {number for key in keys for number in lerobot_tables.contradicting(root, episodes, key, fps=fps)}
    kept = pa.array([number not in wrong for number in episodes["episode_index"].to_pylist()], pa.bool_())
    reason = "it lasts as long in no video as its timesteps do"
    return episodes.filter(kept), {f"episode {number}": reason for number in sorted(wrong)}


def read_info(root: Path) -> dict[str, Any]:
    """Returns `info.json` of a dataset of version 3 with LeRobot's own paths; raises as `read`."""
    path = root / layout.INFO_FILE
    if not path.is_file():
        raise NotFound(
            f"There must be a dataset of this name; got {quoted(root.name)}.",
            hint="`freerein dataset list` names those that there are.",
        )
    with corrupt_as_invalid("`info.json`"):
        info = dict(json_files.read(path, name=layout.INFO_FILE))
    version = str(info.get("codebase_version"))
    if not version.startswith("v3."):
        found, hint = f"version {quoted(version)}", "Convert it with LeRobot's script convert_dataset_v21_to_v30."
        raise must_be("The dataset", "a LeRobotDataset v3", found, field="", hint=hint)
    has_own_paths = info.get("data_path") == layout.DATA_PATH and info.get("video_path") in (None, layout.VIDEO_PATH)
    if not has_own_paths:
        found = ", ".join(quoted(str(info.get(name))) for name in ("data_path", "video_path"))
        raise InvalidInput(
            f"The dataset must keep LeRobot's own paths, {layout.DATA_PATH} and {layout.VIDEO_PATH}; got {found}.",
            hint="Write it again with LeRobotDataset.create.",
        )
    return info


def fps_of(info: Mapping[str, Any]) -> int:
    """Returns the timesteps per second; raises InvalidInput where they are no whole number."""
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or fps not in range(1, _HIGHEST_FPS + 1):
        found, hint = quoted(str(fps)), "Write the dataset again with LeRobotDataset.create."
        raise must_be("`fps` in `info.json`", f"a whole number in [1, {_HIGHEST_FPS}]", found, field="", hint=hint)
    return int(fps)


def _action(root: Path, action: Vector) -> ActionSpec:
    choices = _choices(root, *action.columns) if action.is_discrete else 0
    return ActionSpec(size=action.size, choices=choices, names=action.names)


def _choices(root: Path, key: str) -> int:
    """Returns the number of discrete actions: one more than the largest that occurs."""
    with corrupt_as_invalid("`stats.json`"):
        statistics = json_files.read(root / layout.STATS_FILE, name=layout.STATS_FILE, allows_nan=True)
        largest = float(np.max(statistics[key]["max"]))
    if largest not in range(_MOST_CHOICES):
        name, rule = f"The largest {quoted(key)} in `stats.json`", f"a whole number in [0, {_MOST_CHOICES - 1}]"
        hint = "Discrete actions count from 0; compute the statistics again with LeRobot."
        raise must_be(name, rule, f"{largest:g}", field="", hint=hint)
    return int(largest) + 1
