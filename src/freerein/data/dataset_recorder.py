"""Records demonstrations of the sim service into a dataset; an interrupted recording can be resumed.

<root>/recording.json   the request; only the same request, up to its count, may resume
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from freerein import wire
from freerein.atomic_files import delete_folder, write_atomic
from freerein.clients.tasks import select_task
from freerein.data import DatasetSpec, Writer, create, delete, integer_fps, open_writer
from freerein.errors import FailedPrecondition, InvalidInput, Unavailable
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksResponse, Task


class DatasetRecorder:
    """Writes the demonstrations of a request into a dataset, each once; a context manager.

    A new dataset is made for the first demonstration, so that a request that the service refuses leaves none, and
    keeps one that is to be replaced.

    Args:
        root: The dataset's folder; existing trajectories are kept.
        request: The request; its `first` is ignored.
        tasks: Tasks of the sim service.
        replaces: Whether a dataset that is there is deleted first, whatever it holds.

    Raises:
        NotFound: Unknown task.
        InvalidInput: Unknown camera.
        FailedPrecondition: The dataset was recorded with another request or by another version, or has another writer.
    """

    def __init__(
        self, root: Path, request: DemonstrateRequest, tasks: ListTasksResponse, *, replaces: bool = False
    ) -> None:
        self._root = root
        self._spec = dataset_spec(
            select_task(tasks, request.task), cameras=request.cameras, height=request.height, width=request.width
        )
        free = ("count", "first", "conditions")
        self._as_json = {key: value for key, value in wire.to_json(request).items() if key not in free}
        if request.conditions:
            self._as_json["conditions"] = sorted(request.conditions)
        self._request = request
        self._replaces = replaces
        self._writer = self._open() if root.exists() and not replaces else None

    def __len__(self) -> int:
        """Returns the number of trajectories on disk."""
        return 0 if self._writer is None else len(self._writer)

    @property
    def is_complete(self) -> bool:
        """Whether all demonstrations are on disk."""
        return len(self) >= self._request.count

    @property
    def remaining(self) -> DemonstrateRequest:
        """The request for the demonstrations that are missing."""
        return replace(self._request, first=len(self))

    def append(self, demonstration: DemonstrateResponse) -> None:
        """Writes the next demonstration durably, with labels if the request is privileged."""
        if self._writer is None:
            self._writer = self._open()
        self._writer.append(demonstration.trajectory, demonstration.labels if self._request.privileged else None)

    def check_complete(self) -> None:
        """Raises Unavailable where a stream ended without an error, but too early."""
        if not self.is_complete:
            raise Unavailable(
                "The stream of demonstrations must be whole; it ended early.", hint="Record again to go on."
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._writer is not None:
            close(self._writer, self._root)

    def _open(self) -> Writer:
        if self._replaces and self._root.exists():
            delete(self._root)
        return open_or_resume(self._root, self._spec, self._as_json)


@contextmanager
def recording(root: Path, spec: DatasetSpec, request: Mapping[str, Any]) -> Iterator[Writer]:
    """Yields the writer of `open_or_resume`; a dataset of which nothing was recorded is deleted in the end."""
    writer = open_or_resume(root, spec, request)
    try:
        yield writer
    finally:
        close(writer, root)


def close(writer: Writer, root: Path) -> None:
    """Closes the writer of a dataset; deletes the dataset if nothing was recorded."""
    if not len(writer):
        delete_folder(root)
    writer.close()


def open_or_resume(root: Path, spec: DatasetSpec, request: Mapping[str, Any]) -> Writer:
    """Returns the writer of a new dataset, or of one whose recording was interrupted.

    Args:
        root: The dataset's folder.
        spec: Properties that its trajectories share.
        request: What is recorded, as JSON; must be equal to resume.

    Raises:
        FailedPrecondition: The dataset was recorded with another request, or has another writer.
    """
    writer = _opened(root, spec)
    try:
        path = root / "recording.json"
        earlier = json.loads(path.read_bytes()) if path.is_file() else None
        if len(writer) and earlier != request:
            raise FailedPrecondition(
                "A recording can be resumed only with its own request; this dataset was recorded with another.",
                hint="Choose another name for the dataset, ask for the same with a larger count, or delete it: "
                "`freerein dataset rm NAME`.",
            )
        if writer.spec != spec:
            raise FailedPrecondition(
                "A recording can be resumed only by a version of freerein that stores the same features; this dataset "
                "was begun by another.",
                hint="Choose another name for the dataset, or delete it: `freerein dataset rm NAME`.",
            )
        if earlier != request:
            write_atomic(path, json.dumps(request).encode())
    except BaseException:
        close(writer, root)
        raise
    return writer


def _opened(root: Path, spec: DatasetSpec) -> Writer:
    """Returns the writer of a dataset that holds something, or of a new one: an empty one resumes nothing."""
    if root.exists():
        writer = open_writer(root)
        if len(writer):
            return writer
        close(writer, root)
    return create(root, spec)


def dataset_spec(task: Task, *, cameras: tuple[str, ...], height: int, width: int) -> DatasetSpec:
    """Returns the dataset spec of recordings of a task.

    Args:
        task: The task.
        cameras: Cameras to record; empty for the task's first.
        height: Frame height in pixels; 0 means the cameras' own.
        width: Frame width in pixels; 0 means the cameras' own.

    Raises:
        InvalidInput: Unknown camera.
    """
    known = {camera.name: camera for camera in task.cameras}
    unknown = [name for name in cameras if name not in known]
    if unknown:
        raise InvalidInput(
            f"Cameras must be among the task's, {', '.join(known)}; {len(unknown)} of those asked for are not.",
            field="cameras",
            hint="Leave them out for the task's first.",
        )
    chosen = [known[name] for name in cameras] or list(task.cameras[:1])
    return DatasetSpec(
        fps=integer_fps(task.control_dt_s),
        cameras={camera.name: (height or camera.height, width or camera.width, camera.channels) for camera in chosen},
        action=task.action,
        robot_type=task.world,
        skills=task.skills,
        task=task.goal_text or task.name,
        has_terminations=True,
    )
