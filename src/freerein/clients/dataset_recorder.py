"""Recordings over the network, as the command line and runs make them: begun once, gone on with until they are whole.

<root>/recording.json   what was asked for: only the same may go on, but for a count
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from freerein import wire
from freerein.atomic_files import write_atomic
from freerein.clients.tasks import select_task
from freerein.data import DatasetSpec, Writer, create, integer_fps, open_writer
from freerein.errors import FailedPrecondition, InvalidInput, Unavailable
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksResponse, Task

_ASKED = "recording.json"


class DatasetRecorder:
    """A dataset that the demonstrations of a request go into, each of them once; use it as a context manager.

    Args:
        root: Where the dataset lies, or will lie. What it holds already stays.
        request: What to demonstrate; `first` is chosen here.
        tasks: What the sim service has.

    Raises:
        NotFound: The sim service has no such task.
        InvalidInput: The task has no such camera.
        FailedPrecondition: The dataset holds something else, or somebody else writes to it.
    """

    def __init__(self, root: Path, request: DemonstrateRequest, tasks: ListTasksResponse) -> None:
        spec = dataset_spec(
            select_task(tasks, request.task), cameras=request.cameras, height=request.height, width=request.width
        )
        asked = {key: value for key, value in wire.to_json(request).items() if key not in ("count", "first")}
        self._request = request
        self._writer = open_or_resume(root, spec, asked)

    def __len__(self) -> int:
        """Returns the number of trajectories on disk."""
        return len(self._writer)

    @property
    def is_whole(self) -> bool:
        """Whether every demonstration is on disk."""
        return len(self) >= self._request.count

    @property
    def rest(self) -> DemonstrateRequest:
        """What is still to be demonstrated."""
        return replace(self._request, first=len(self))

    def append(self, demonstration: DemonstrateResponse) -> None:
        """Writes the next demonstration durably, with its labels where the request is privileged."""
        self._writer.append(demonstration.trajectory, demonstration.labels if self._request.privileged else None)

    def check_whole(self) -> None:
        """Checks that a stream which ended without an error brought all there was to come.

        Raises:
            Unavailable: It did not.
        """
        if not self.is_whole:
            raise Unavailable(
                "The stream of demonstrations must be whole; it ended early.", hint="Record again to go on."
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._writer.close()


def open_or_resume(root: Path, spec: DatasetSpec, asked: Mapping[str, Any]) -> Writer:
    """Returns the writer of a dataset that is recorded now, or whose recording was begun earlier.

    Args:
        root: Where the dataset lies, or will lie.
        spec: What its trajectories have in common.
        asked: What is recorded, as JSON.

    Raises:
        FailedPrecondition: The dataset holds something else, or somebody else writes to it.
    """
    writer = open_writer(root) if root.exists() else create(root, spec)
    try:
        begun = _asked_before(root)
        if len(writer) and begun != asked:
            raise FailedPrecondition(
                "A recording can only go on with the request that began it; this dataset was recorded with another.",
                hint="Choose another name for the dataset, or ask for the same with a larger count.",
            )
        if begun != asked:
            write_atomic(root / _ASKED, json.dumps(asked).encode())
    except BaseException:
        writer.close()
        raise
    return writer


def dataset_spec(task: Task, *, cameras: tuple[str, ...], height: int, width: int) -> DatasetSpec:
    """Returns what all trajectories that are recorded of a task have in common.

    Args:
        task: The task.
        cameras: The cameras to record; empty for the task's first.
        height: Of the frames, in pixels; 0 means the cameras' own.
        width: As `height`.

    Raises:
        InvalidInput: The task has no such camera.
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
    )


def _asked_before(root: Path) -> object:
    path = root / _ASKED
    return json.loads(path.read_bytes()) if path.is_file() else None
