"""Reads the MIME dataset (Sharma et al., "Multiple Interactions Made Easy", 2018) from its folders.

    <folder>/<task>/<demonstration>/joint_angles.txt     a Python dictionary per line: angle in radians by joint
                                    left_gripper.txt     a number per line; as right_gripper.txt
                                    rd_kinect_rgb.mp4    the robot's demonstration, seen by a Kinect

The publisher's own description could not be reached. The names are those that several public loaders of the dataset
agree on, and nothing here was tried on the original files. That `rd` is the robot's and `hd` the human's demonstration,
and that all files of a demonstration begin and end together, are assumptions.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data.importing import Source
from freerein.data.layout import DatasetSpec
from freerein.data.videos import BOUNDS, joined
from freerein.errors import InvalidInput, NotFound, quoted
from freerein.regular_files import read_regular
from freerein.types.common import ActionSpec, Trajectory
from freerein.video import frames_at_rate, open_video

_ANGLES, _VIDEO = "joint_angles.txt", "rd_kinect_rgb.mp4"
_GRIPPERS = ("left_gripper", "right_gripper")
_STILL = ("head_nod", "head_pan", "torso_t0")  # joints that do not take part in a demonstration
_REACH = "reach"
_CAMERA = "kinect"
_SIZE, _FPS = (120, 320), 5
_PAIR = r"u?'(\w{1,32})'\s*:\s*(-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
_DICTIONARY = re.compile(rf"\{{\s*{_PAIR}(?:\s*,\s*{_PAIR})*\s*\}}")


class MimeSource(Source):
    """The robot's demonstrations, in gray at 120 x 320 as in section 2.4 of the dissertation, at 5 timesteps a second.

    Each is tagged with `reach` and its task: the folder's name in lower case, without `mime_`. The action of a timestep
    is where arms and grippers are at the next one, in radians and the gripper's own unit.

    Args:
        folder: Holds a folder for each task.
        size: Height and width to scale frames to.

    Raises:
        NotFound: There are no demonstrations.
        InvalidInput: The first of them is corrupt.
    """

    def __init__(self, folder: Path, *, size: tuple[int, int] | None = None) -> None:
        self._size = size or _SIZE
        found = (path.parent for file in (_ANGLES, _VIDEO) for path in folder.glob(f"*/*/{file}"))
        self._demonstrations = sorted(set(found))
        if not self._demonstrations:
            raise NotFound(
                f"There must be folders TASK/DEMONSTRATION with `{_ANGLES}`; {quoted(str(folder))} has none.",
                hint="Name the folder that holds the folders of the tasks.",
            )
        self._joints = tuple(sorted(set(_angles(self._demonstrations[0])[0]) - set(_STILL)))
        names = (*self._joints, *_GRIPPERS)
        self.spec = DatasetSpec(
            fps=_FPS,
            cameras={_CAMERA: (*self._size, 1)},
            action=ActionSpec(size=len(names), choices=0, names=names),
            robot_type="baxter",
            skills=tuple(sorted({_REACH, *map(_task, self._demonstrations)})),
            has_scaled_actions=False,
        )

    def __len__(self) -> int:
        return len(self._demonstrations)

    def __iter__(self) -> Iterator[Trajectory]:
        for demonstration in self._demonstrations:
            frames = self._frames(demonstration)
            positions = self._positions(demonstration, len(frames))
            actions = np.concatenate([positions[1:], positions[-1:]])
            skills = tuple(sorted({_REACH, _task(demonstration)}))
            yield Trajectory({_CAMERA: frames}, actions, skills, goal_text=_task(demonstration))

    def _frames(self, demonstration: Path) -> npt.NDArray[np.uint8]:
        """Returns the frames at the dataset's rate, uint8 (T, H, W, 1)."""
        name = _present(demonstration, _VIDEO)
        with open_video(demonstration / _VIDEO, channels=1, size=self._size, bounds=BOUNDS, field=name) as video:
            sampled = frames_at_rate(video, fps=_FPS, file=name)
            return joined((frame.pixels for frame in sampled), (*self._size, 1))

    def _positions(self, demonstration: Path, length: int) -> npt.NDArray[np.float32]:
        """Returns where joints and grippers are at each timestep, float32 (T, A)."""
        angles = _angles(demonstration)
        if any(not set(self._joints) <= set(each) for each in angles):
            raise _corrupt(demonstration, _ANGLES, f"the {len(self._joints)} joints of the first demonstration")
        joints = np.array([[each[joint] for joint in self._joints] for each in angles])
        parts = [joints, *(_gripper(demonstration, name)[:, None] for name in _GRIPPERS)]
        return np.concatenate([_spread(part, length) for part in parts], axis=1).astype(np.float32)


def _angles(demonstration: Path) -> list[dict[str, float]]:
    """Returns the angle of each joint, line by line."""
    lines = [line.strip() for line in _text(demonstration, _ANGLES).splitlines() if line.strip()]
    if not lines or not all(_DICTIONARY.fullmatch(line) for line in lines):
        raise _corrupt(demonstration, _ANGLES, "a dictionary of angles on every line")
    return [{joint: float(angle) for joint, angle in re.findall(_PAIR, line)} for line in lines]


def _gripper(demonstration: Path, name: str) -> npt.NDArray[np.float64]:
    try:
        values = np.array([float(word) for word in _text(demonstration, f"{name}.txt").split()])
    except ValueError:
        values = np.array([np.nan])
    if not len(values) or not np.isfinite(values).all():
        raise _corrupt(demonstration, f"{name}.txt", "a number on every line")
    return values


def _spread(values: npt.NDArray[np.float64], length: int) -> npt.NDArray[np.float64]:
    """Returns `length` of the rows (N, D), evenly from the first to the last: sensors have rates of their own."""
    spread: npt.NDArray[np.float64] = values[np.linspace(0, len(values) - 1, length).round().astype(np.int64)]
    return spread


def _text(demonstration: Path, file: str) -> str:
    return read_regular(demonstration / file, name=_present(demonstration, file)).decode(errors="replace")


def _present(demonstration: Path, file: str) -> str:
    """Returns the name of a file in errors; raises InvalidInput where it is missing."""
    name = _name(demonstration, file)
    if not (demonstration / file).is_file():
        raise InvalidInput(f"`{name}` must be there; it is missing.", hint="Restore it, or move the folder away.")
    return name


def _corrupt(demonstration: Path, file: str, expected: str) -> InvalidInput:
    sentence = f"`{_name(demonstration, file)}` must hold {expected}; it does not."
    return InvalidInput(sentence, hint="Restore it from a copy, or move the folder away.")


def _name(demonstration: Path, file: str) -> str:
    return f"{demonstration.parent.name}/{demonstration.name}/{file}"


def _task(demonstration: Path) -> str:
    return demonstration.parent.name.lower().removeprefix("mime_")
