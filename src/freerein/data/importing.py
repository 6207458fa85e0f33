"""Imports trajectories of other tools as a dataset of ours: all of them, or none."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from freerein.atomic_files import fsync_folder
from freerein.data import hand_labels, tags, truth
from freerein.data.counter_columns import CounterColumns
from freerein.data.folder_locks import temporary_folder
from freerein.data.layout import DatasetSpec
from freerein.data.meta import save_teachers
from freerein.data.removal import delete, replace
from freerein.data.trajectory_file import State
from freerein.data.writer import Writer, create
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput
from freerein.types.common import Trajectory


@dataclass(frozen=True, eq=False)
class Recorded:
    """A trajectory of another tool, its name in errors, and what is stored beside it, None where there is none.

    Attributes:
        robot_state: The robot's own state, float32 (T, S).
        labels: True labels, int64 (T,), indices into the spec's skills, or -1 where unknown.
    """

    trajectory: Trajectory
    name: str
    robot_state: State | None = None
    labels: npt.NDArray[np.int64] | None = None


class Source(Protocol):
    """Trajectories of another tool.

    Attributes:
        spec: Properties that they share, as they will be stored.
    """

    spec: DatasetSpec

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
        """How the source was read, in a few words; may be empty."""
        return ""

    @property
    def teachers(self) -> Sequence[Mapping[str, Any]]:
        """Cards of the policies that acted, which a learner's card names; empty for demonstrations."""
        return ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences of what was left out or changed; complete once every trajectory was yielded."""
        return ()


def import_trajectories(source: Source, root: Path) -> tuple[str, ...]:
    """Writes a new dataset with the trajectories of a source, as `imported`; returns warnings of what was written."""
    with imported(source, root) as warnings:
        return warnings


@contextmanager
def imported(
    source: Source,
    root: Path,
    *,
    replaces: bool = False,
    check_unused: Callable[[], object] = lambda: None,
    on_count: Callable[[int], None] = lambda _: None,
) -> Iterator[tuple[str, ...]]:
    """Writes a new dataset with the trajectories of a source; nothing is left of one that fails.

    Nor of one where the body raises, unless the dataset is in use by then: one that it replaced is back.

    Args:
        source: The trajectories.
        root: The new dataset's folder.
        replaces: Whether a dataset that is there is replaced, once the new one is whole.
        check_unused: Raises FailedPrecondition where a dataset is in use that would be replaced or deleted.
        on_count: Called with the number of trajectories written.

    Yields:
        Warnings of what was written.

    Raises:
        AlreadyExists: `root` exists, and is not to be replaced.
        FailedPrecondition: The dataset to replace is in use or being written, or cannot be replaced in one step.
        InvalidInput: A trajectory is missing or corrupt, does not match the spec, or there is none.
        UnsupportedMedia, Unimplemented: As `freerein.video.open_video`.
    """
    if _is_taken(root) and not replaces:
        raise _taken()
    if not len(source):
        raise InvalidInput("What is imported must hold a trajectory; it holds none.", hint="Name another folder.")
    with temporary_folder(root.parent, prefix=".import-") as folder:
        unfinished = folder / root.name
        if replaces:
            hand_labels.check_none(root)
        warnings = (*_write(source, unfinished, on_count), *_given_up(root))
        publish(unfinished, root, replaces=replaces, check_unused=check_unused)
        try:
            yield warnings
        except BaseException:
            with suppress(FailedPrecondition):
                _undo(unfinished, root, check_unused)
            raise


def _write(source: Source, unfinished: Path, on_count: Callable[[int], None]) -> tuple[str, ...]:
    with create(unfinished, source.spec) as writer:
        counters = CounterColumns(source.spec.action.names)
        for count, recorded in enumerate(source.recorded(), start=1):
            _append(writer, unfinished, source, recorded)
            counters.add(recorded.trajectory.actions)
            on_count(count)
        if not len(writer):
            raise InvalidInput("A trajectory must be whole; none is.", hint="`freerein dataset verify FOLDER`.")
    if source.teachers:
        save_teachers(unfinished, source.teachers)
    return tuple(counters.sentences())


def publish(unfinished: Path, root: Path, *, replaces: bool, check_unused: Callable[[], object]) -> None:
    """Gives a new dataset its name; where there is one of that name, they change places, or this is refused."""
    if replaces and _is_taken(root):
        replace(root, unfinished, check_unused=check_unused)
        return
    try:
        unfinished.rename(root)
    except OSError:
        raise _taken() from None
    fsync_folder(root.parent)


def _undo(replaced: Path, root: Path, check_unused: Callable[[], object]) -> None:
    """Gives the dataset that was replaced its name again; where there was none, the new one is deleted."""
    if _is_taken(replaced):
        replace(root, replaced, check_unused=check_unused)
    else:
        check_unused()
        delete(root)


def _given_up(root: Path) -> Iterator[str]:
    """Yields a sentence of what people gave a dataset that is to be replaced, which the new one lacks."""
    found = {"tags": tags.read(root), "true labels": truth.labelled(root)}
    if given := [name for name, each in found.items() if each]:
        yield f"The dataset that was replaced had {' and '.join(given)} of its own: give them again."


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
    hint = "Choose another name, use that dataset, or replace it: --replace. `freerein dataset rm NAME` deletes it."
    return AlreadyExists("A new dataset needs a name that is not taken; this one is.", field="dataset", hint=hint)
