"""Which features of a LeRobotDataset are read: cameras, action, robot state, terminations; and why others are not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from freerein.data import layout
from freerein.data.frame_axes import frame_size, is_length
from freerein.errors import InvalidInput, quoted
from freerein.types.common import check_name

_INDICES = frozenset(("timestamp", "frame_index", "episode_index", "index", "task_index"))
_ACTION = "action"
SUBTASK_COLUMNS = ("subtask_index", "language_persistent")
_MOST_NUMBERS = 10_000
"""Most numbers of an action, or of a state."""


@dataclass(frozen=True)
class LeRobotOptions:
    """The features to read of a dataset; those of LeRobot's usual names where none are named.

    Attributes:
        action: Columns that together are the action.
        state: Columns that together are the robot's own state.
        cameras: Cameras, by the name of the feature or of ours.
        skip_damaged: Whether to leave out files of `meta/episodes` that are damaged, and so their episodes.
    """

    action: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    cameras: tuple[str, ...] = ()
    skip_damaged: bool = False


DEFAULTS = LeRobotOptions()


@dataclass(frozen=True)
class Camera:
    """The feature of a camera whose frames (H, W, C) can be read: from the data files, or from mp4 files."""

    key: str
    size: tuple[int, int, int]
    is_video: bool


@dataclass(frozen=True)
class Vector:
    """Columns, of these sizes, that together hold a vector; `is_discrete` where it is one int64.

    `names` are the meaning of each number; they may be empty.
    """

    columns: Mapping[str, int]
    names: tuple[str, ...] = ()
    is_discrete: bool = False

    @property
    def size(self) -> int:
        """Returns the number of numbers."""
        return sum(self.columns.values())


@dataclass(frozen=True)
class Features:
    """The features that are read, empty where there is none, and why each of the others is not."""

    cameras: Mapping[str, Camera]
    action: Vector
    state: Vector
    terminated: str
    left_out: Mapping[str, str]


def described(features: object) -> dict[str, dict[str, Any]]:
    """Returns the `features` of `info.json`; raises InvalidInput where they are no objects by name."""
    if not isinstance(features, dict) or not all(isinstance(each, dict) for each in features.values()):
        raise InvalidInput(
            "`info.json` must describe `features`, of which at least one is a camera; it does not.",
            hint="Open the dataset in LeRobot to see what it lacks.",
        )
    return features


def choose(
    features: Mapping[str, dict[str, Any]], options: LeRobotOptions, *, unlocated: Sequence[str] = ()
) -> Features:
    """Returns what to read of features; of the `unlocated` ones `meta/episodes` does not say where their video lies.

    Raises InvalidInput where there is no camera that can be read, or no such feature as chosen, or one of another kind.
    """
    found, unreadable = _cameras(features, unlocated)
    cameras = _chosen_cameras(found, unreadable, options.cameras)
    action = _action(features, options.action)
    state, unusable = _state(features, options.state)
    terminated = _terminated(features)
    read = {each.key for each in cameras.values()} | set(action.columns) | set(state.columns) | {terminated}
    unread = {key: _hint(key, each, action, state) for key, each in features.items() if key not in read | _INDICES}
    return Features(cameras, action, state, terminated, {**unread, **unusable, **unreadable})


def _cameras(
    features: Mapping[str, dict[str, Any]], unlocated: Sequence[str]
) -> tuple[dict[str, Camera], dict[str, str]]:
    """Returns the cameras that can be read, by name, and why the others cannot, by feature."""
    cameras, unreadable = dict[str, Camera](), dict[str, str]()
    for key, feature in features.items():
        if feature.get("dtype") not in ("image", "video"):
            continue
        name = key.removeprefix(layout.CAMERA_PREFIX).removeprefix("observation.").lower()
        size = frame_size(feature)
        if _is_depth(feature):
            unreadable[key] = "a depth map"
        elif size is None:
            unreadable[key] = "its shape must be a height, a width and 1 or 3 channels"
        elif not _is_name(name):
            unreadable[key] = "its name must be letters, digits, dots, dashes and underscores"
        elif key in unlocated:
            unreadable[key] = "`meta/episodes` does not say where its video lies"
        elif name in cameras:
            unreadable[key] = "another camera has its name, but for capital letters or what precedes it"
        else:
            cameras[name] = Camera(key, size, feature["dtype"] == "video")
    return cameras, unreadable


def _chosen_cameras(cameras: dict[str, Camera], unreadable: dict[str, str], asked: Sequence[str]) -> dict[str, Camera]:
    """Returns the cameras asked for, or all; those that were not asked for are added to the unreadable ones."""
    for each in asked:
        is_known = each in cameras or any(each == camera.key for camera in cameras.values())
        if not is_known:
            reason = unreadable.get(each) or unreadable.get(layout.camera_key(each))
            raise InvalidInput(
                f"The camera {quoted(each)} must be among those that can be read, {_listed(cameras)}; "
                f"{f'it is not: {reason}' if reason else 'there is none of this name'}.",
                field="cameras",
                hint="Choose another.",
            )
    if not cameras:
        found = "; ".join(f"{quoted(key)} cannot be read: {why}" for key, why in unreadable.items())
        raise InvalidInput(
            f"`info.json` must describe a camera that can be read; {found or 'it describes none'}.",
            hint="A camera is a feature of dtype image or video; open the dataset in LeRobot to see its shape.",
        )
    chosen = {name: each for name, each in cameras.items() if not asked or name in asked or each.key in asked}
    unreadable |= {each.key: "another was chosen" for name, each in cameras.items() if name not in chosen}
    return chosen


def _is_name(name: str) -> bool:
    try:
        check_name(name, field="cameras")
    except InvalidInput:
        return False
    return True


def _is_depth(feature: Mapping[str, Any]) -> bool:
    info = feature.get("info") or feature.get("video_info") or {}
    return isinstance(info, dict) and any(name.endswith("is_depth_map") and bool(value) for name, value in info.items())


def _terminated(features: Mapping[str, dict[str, Any]]) -> str:
    """Returns the column of the terminations; empty where there is none."""
    bools = [key for key, each in features.items() if each.get("dtype") == "bool" and each.get("shape") == [1]]
    return next((key for key in (layout.TERMINATED_KEY, "next.done") if key in bools), "")


def _action(features: Mapping[str, dict[str, Any]], asked: tuple[str, ...]) -> Vector:
    keys = asked or ((_ACTION,) if _ACTION in features else ())
    _check_known(features, keys, "action")
    if len(keys) == 1 and features[keys[0]].get("dtype") == "int64" and features[keys[0]].get("shape") == [1]:
        return Vector({keys[0]: 1}, is_discrete=True)
    vector = _vector(features, keys, any_number=bool(asked))
    if vector is None:
        raise InvalidInput(
            f"An action must be a vector of floats, or one int64; {_listed(keys)} is of another kind, or too long.",
            field="action",
            hint="Convert the action before recording, or choose another feature: --action NAME.",
        )
    return vector


def _state(features: Mapping[str, dict[str, Any]], asked: tuple[str, ...]) -> tuple[Vector, dict[str, str]]:
    """Returns the robot's own state, and why a feature of its name is not read."""
    _check_known(features, asked, "state")
    keys = asked or ((layout.STATE_KEY,) if layout.STATE_KEY in features else ())
    vector = _vector(features, keys, any_number=bool(asked))
    if vector is None and asked:
        raise InvalidInput(
            f"A robot's state must be a vector of floats; {_listed(asked)} is of another kind, or too long.",
            field="state",
            hint="Choose another feature: --state NAME.",
        )
    return (Vector({}), {keys[0]: "a state must be a vector of floats"}) if vector is None else (vector, {})


def _check_known(features: Mapping[str, object], keys: Sequence[str], field: str) -> None:
    unknown = [key for key in keys if key not in features]
    if unknown or len(set(keys)) != len(keys):
        raise InvalidInput(
            f"The features of `{field}` must be among the dataset's, {_listed(features)}, each once; "
            f"{quoted(unknown[0]) + ' is not' if unknown else 'one is named twice'}.",
            field=field,
            hint=f"For example: --{field} {next(iter(features), field)}.",
        )


def _vector(features: Mapping[str, dict[str, Any]], keys: Sequence[str], *, any_number: bool) -> Vector | None:
    """Returns features side by side; None where one is no vector of floats, or of any numbers, or too long."""
    kinds = ("float", "int", "uint", "bool") if any_number else ("float",)
    columns, names = dict[str, int](), list[str]()
    for key in keys:
        shape, dtype = features[key].get("shape"), features[key].get("dtype")
        if not isinstance(dtype, str) or not dtype.startswith(kinds) or not isinstance(shape, list):
            return None
        if len(shape) != 1 or not is_length(shape[0]):
            return None
        columns[key] = int(shape[0])
        names += _flat_names(features[key].get("names"), columns[key]) or [key] * (len(keys) > 1) * columns[key]
    vector = Vector(columns, tuple(names))
    return vector if vector.size <= _MOST_NUMBERS else None


def _flat_names(names: object, size: int) -> list[str]:
    """Returns the names of a list, or of lists by group, as LeRobot has them; empty where there are not as many."""
    groups = names.values() if isinstance(names, dict) else [names]
    flat = [str(name) for group in groups if isinstance(group, list) for name in group]
    return flat if len(flat) == size else []


def _hint(key: str, feature: Mapping[str, Any], action: Vector, state: Vector) -> str:
    """Returns why a feature is not read, and how it would be where it may be what is missing."""
    is_vector = str(feature.get("dtype")).startswith("float")
    if is_vector and not action.columns and _ACTION in key:
        return f"take it as the action with --action {key}"
    if key in SUBTASK_COLUMNS:
        return "take it as tags with --tags-from subtask"
    if is_vector and not state.columns and "state" in key:
        return f"take it as the robot's state with --state {key}"
    return "not read"


def _listed(names: Mapping[str, object] | Sequence[str]) -> str:
    return ", ".join(map(quoted, names)) or "none"
