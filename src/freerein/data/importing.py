"""Imports trajectories of other tools as a dataset of ours: all of them, or none."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from freerein.atomic_files import fsync_folder
from freerein.data.folder_locks import temporary_folder
from freerein.data.layout import DatasetSpec
from freerein.data.reader import Dataset
from freerein.data.trajectory_file import State
from freerein.data.writer import create
from freerein.errors import AlreadyExists, InvalidInput, NotFound
from freerein.types.common import Trajectory


_ROUNDING = 1.03
"""Ratio of proportions up to which they are one: 1080 x 1920 is scaled to 72 x 128, or to 54 x 96."""


class Source(Protocol):
    """Trajectories of another tool."""

    @property
    def spec(self) -> DatasetSpec:
        """Properties that they share, as they will be stored."""

    def __len__(self) -> int:
        """Returns their number."""

    def __iter__(self) -> Iterator[Trajectory]:
        """Yields each, decoded; raises InvalidInput where one is missing, corrupt or does not match the spec."""

    def robot_state(self, index: int) -> State | None:
        """Returns the robot's own state in one of them, float32 (T, S); None where the tool does not record it."""
        return None

    @property
    def contents(self) -> str:
        """What was taken for what, in a few words; may be empty."""
        return ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences of what was left out or changed; complete once every trajectory was yielded."""
        return ()


class LeRobotSource(Source):
    """The trajectories of a LeRobotDataset v3, of images or video; actions and `observation.state` stay in their units.

    Args:
        folder: Its folder.
        size: Height and width to scale frames to; None to keep their own.

    Raises:
        NotFound: There is no dataset.
        InvalidInput: It is not a supported LeRobotDataset v3, or corrupt.
    """

    def __init__(self, folder: Path, *, size: tuple[int, int] | None = None) -> None:
        try:
            self._dataset = Dataset(folder)
        except NotFound:
            raise NotFound(
                "There must be a LeRobotDataset v3 in the folder, with `meta/info.json`; there is none.",
                hint="Name the folder that holds `meta`; for the MIME dataset add --layout mime.",
            ) from None
        self._size = size
        own = self._dataset.spec
        cameras = {
            name: (*(size or (height, width)), channels) for name, (height, width, channels) in own.cameras.items()
        }
        self._spec = replace(own, cameras=cameras)

    @property
    def spec(self) -> DatasetSpec:
        """Properties that they share."""
        return self._spec

    def __len__(self) -> int:
        return len(self._dataset)

    def __iter__(self) -> Iterator[Trajectory]:
        for trajectory in self._dataset.stream(range(len(self)), size=self._size):
            yield replace(trajectory, skills=tuple(sorted(set(trajectory.skills))))

    def robot_state(self, index: int) -> State | None:
        """Returns `observation.state` of a trajectory, float32 (T, S); None where there is none."""
        return self._dataset.robot_state(index)


def import_trajectories(source: Source, root: Path, *, on_count: Callable[[int], None] = lambda _: None) -> None:
    """Writes a new dataset with the trajectories of a source; nothing is left of one that fails.

    Args:
        source: The trajectories.
        root: The new dataset's folder.
        on_count: Called with the number of trajectories written.

    Raises:
        AlreadyExists: `root` exists.
        InvalidInput: A trajectory is missing or corrupt, does not match the spec, or there is none.
        UnsupportedMedia, Unimplemented: As `freerein.video.open_video`.
    """
    if root.exists():
        raise _taken()
    if not len(source):
        raise InvalidInput("What is imported must hold a trajectory; it holds none.", hint="Name another folder.")
    root.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(root.parent, prefix=".import-") as folder:
        unfinished = folder / root.name
        with create(unfinished, source.spec) as writer:
            for index, trajectory in enumerate(source):
                writer.append(trajectory, robot_state=source.robot_state(index))
                on_count(index + 1)
        try:
            unfinished.rename(root)
        except OSError:
            raise _taken() from None
    fsync_folder(root.parent)


def are_stretched(shape: tuple[int, ...], size: tuple[int, int]) -> bool:
    """Returns whether frames (H, W, ...) have other proportions than a height and width; rounding is allowed."""
    ratio = shape[0] * size[1] / (shape[1] * size[0])
    return not 1 / _ROUNDING <= ratio <= _ROUNDING


def stretch_notes(stretched: Mapping[str, tuple[int, ...]], size: tuple[int, int] | None) -> tuple[str, ...]:
    """Returns a sentence about frames, by name, that are stretched from a height and width to `size`; none without."""
    if not stretched or size is None:
        return ()
    name, (height, width) = next(iter(stretched.items()))
    others = f" and those of {len(stretched) - 1} others" if len(stretched) > 1 else ""
    return (
        f"Frames of `{name}`, {height} x {width},{others} were stretched to {size[0]} x {size[1]}, of other "
        "proportions: crop or turn them first.",
    )


def _taken() -> AlreadyExists:
    return AlreadyExists(
        "A new dataset needs a name that is not taken; this one is.", hint="Choose another name, or use that dataset."
    )
