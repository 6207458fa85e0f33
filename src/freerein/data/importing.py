"""Imports trajectories of other tools as a dataset of ours: all of them, or none."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from freerein.atomic_files import fsync_folder
from freerein.data import truth
from freerein.data.counter_columns import CounterColumns
from freerein.data.folder_locks import temporary_folder
from freerein.data.layout import DatasetSpec
from freerein.data.removal import replace
from freerein.data.trajectory_file import State
from freerein.data.writer import Writer, create
from freerein.errors import AlreadyExists, InvalidInput
from freerein.types.common import Trajectory


@dataclass(frozen=True, eq=False)
class Recorded:
    """A trajectory of another tool, and what is stored beside it.

    Attributes:
        trajectory: The trajectory.
        name: Its name in errors.
        robot_state: The robot's own state, float32 (T, S); None where the tool does not record it.
        labels: True labels, int64 (T,), indices into the spec's skills, or -1 where unknown; None where there are none.
    """

    trajectory: Trajectory
    name: str
    robot_state: State | None = None
    labels: npt.NDArray[np.int64] | None = None


class Source(Protocol):
    """Trajectories of another tool."""

    @property
    def spec(self) -> DatasetSpec:
        """Properties that they share, as they will be stored."""

    def __len__(self) -> int:
        """Returns their number."""

    def __iter__(self) -> Iterator[Trajectory]:
        """Yields each, decoded; raises InvalidInput where one is missing, corrupt or does not match the spec."""

    def recorded(self) -> Iterator[Recorded]:
        """Yields each with what is stored beside it; raises as `__iter__`."""
        return (Recorded(each, name=f"Trajectory {index}") for index, each in enumerate(self))

    def skips(self, error: InvalidInput) -> bool:
        """Returns whether to go on without a trajectory that cannot be written."""
        return False

    @property
    def contents(self) -> str:
        """What was taken for what, in a few words; may be empty."""
        return ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences of what was left out or changed; complete once every trajectory was yielded."""
        return ()


def import_trajectories(
    source: Source, root: Path, *, replaces: bool = False, on_count: Callable[[int], None] = lambda _: None
) -> tuple[str, ...]:
    """Writes a new dataset with the trajectories of a source; nothing is left of one that fails.

    Args:
        source: The trajectories.
        root: The new dataset's folder.
        replaces: Whether a dataset that is there is replaced, once the new one is whole.
        on_count: Called with the number of trajectories written.

    Returns:
        Warnings of what was written.

    Raises:
        AlreadyExists: `root` exists, and is not to be replaced.
        FailedPrecondition: The dataset to replace is being written.
        InvalidInput: A trajectory is missing or corrupt, does not match the spec, or there is none.
        UnsupportedMedia, Unimplemented: As `freerein.video.open_video`.
    """
    if _is_taken(root) and not replaces:
        raise _taken()
    if not len(source):
        raise InvalidInput("What is imported must hold a trajectory; it holds none.", hint="Name another folder.")
    root.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(root.parent, prefix=".import-") as folder:
        unfinished = folder / root.name
        with create(unfinished, source.spec) as writer:
            counters = CounterColumns(source.spec.action.names)
            for count, recorded in enumerate(source.recorded(), start=1):
                _append(writer, unfinished, source, recorded)
                counters.add(recorded.trajectory.actions)
                on_count(count)
            if not len(writer):
                raise InvalidInput("A trajectory must be whole; none is.", hint="`freerein dataset verify FOLDER`.")
        _publish(unfinished, root, aside=folder / "replaced" if replaces else None)
    return tuple(counters.sentences())


def _publish(unfinished: Path, root: Path, *, aside: Path | None) -> None:
    """Gives a new dataset its name; where there is one of that name, it is moved aside, or this is refused."""
    if aside is not None and _is_taken(root):
        replace(root, unfinished, aside=aside)
        return
    try:
        unfinished.rename(root)
    except OSError:
        raise _taken() from None
    fsync_folder(root.parent)


def _is_taken(root: Path) -> bool:
    return root.exists() or root.is_symlink()


def _append(writer: Writer, root: Path, source: Source, recorded: Recorded) -> None:
    try:
        index = writer.append(recorded.trajectory, robot_state=recorded.robot_state)
        if recorded.labels is not None:
            truth.save(root, index, recorded.labels)
    except InvalidInput as error:
        named = InvalidInput(f"{recorded.name}: {error.detail}", field=error.field, hint=error.hint)
        if not source.skips(named):
            raise named from None


def _taken() -> AlreadyExists:
    return AlreadyExists(
        "A new dataset needs a name that is not taken; this one is.",
        field="dataset",
        hint="Choose another name, use that dataset, or replace it: --replace. `freerein dataset rm NAME` deletes it.",
    )
