"""Records demonstrations of the sim service into a dataset; an interrupted recording can be resumed.

<root>/recording.json   the request; only the same request, up to its count, may resume
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

from freerein import wire
from freerein.atomic_files import delete_folder, write_atomic
from freerein.clients.tasks import select_task
from freerein.data import DatasetSpec, Writer, create, integer_fps, labels, layout, meta, open_writer, tags, truth
from freerein.data.folder_locks import temporary_folder
from freerein.data.importing import publish
from freerein.errors import FailedPrecondition, InvalidInput, Unavailable
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksResponse, Task

_REQUEST_FILE = "recording.json"


class DatasetRecorder:
    """Writes the demonstrations of a request into a dataset, each once; a context manager.

    A new dataset is made for the first demonstration, so that a request that the service refuses leaves none. One that
    is to replace another is made beside it; the other goes once the new one is complete, else the new one does.

    Args:
        root: The dataset's folder; existing trajectories are kept.
        request: The request; its `first` is ignored.
        tasks: Tasks of the sim service.
        replaces: Whether a dataset that is there is replaced, whatever it holds.
        check_unused: Called just before; raises where it must not be replaced.

    Raises:
        NotFound: Unknown task.
        InvalidInput: Unknown camera.
        FailedPrecondition: The dataset was recorded with another request or by another version, or has another writer.
    """

    def __init__(
        self,
        root: Path,
        request: DemonstrateRequest,
        tasks: ListTasksResponse,
        *,
        replaces: bool = False,
        check_unused: Callable[[], object] = lambda: None,
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
        self._replaces = replaces and root.exists()
        self._check_unused = check_unused
        self._opened = ExitStack()
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

    def __exit__(self, *raised: Any) -> None:
        self._opened.__exit__(*raised)

    def _open(self) -> Writer:
        root = self._opened.enter_context(self._replacement()) if self._replaces else self._root
        return self._opened.enter_context(recording(root, self._spec, self._as_json))

    @contextmanager
    def _replacement(self) -> Iterator[Path]:
        """Yields the folder of a dataset that takes its place in the end, if it is complete."""
        with temporary_folder(self._root.parent, prefix=".record-") as folder:
            yield folder / self._root.name
            if self.is_complete:
                publish(folder / self._root.name, self._root, replaces=True, check_unused=self._check_unused)


@contextmanager
def recording(root: Path, spec: DatasetSpec, request: Mapping[str, Any]) -> Iterator[Writer]:
    """Yields the writer of a new dataset, deleted if nothing is recorded, or of one whose recording was interrupted.

    `request` is what is recorded, as JSON; it must be equal to resume.

    Raises:
        NotFound: There is something else in `root`.
        FailedPrecondition: The dataset was recorded with another request, has other features, has lost its
            trajectories, or has another writer.
    """
    is_new = not root.exists()
    if not is_new:
        _check_resumable(root, spec, request)
    with create(root, spec) if is_new else open_writer(root) as writer:
        try:
            if not (root / _REQUEST_FILE).exists():
                write_atomic(root / _REQUEST_FILE, json.dumps(request).encode())
            yield writer
        finally:
            if is_new and not len(writer):
                delete_folder(root)


def _check_resumable(root: Path, spec: DatasetSpec, request: Mapping[str, Any]) -> None:
    """Raises FailedPrecondition where a recording is not to go on, before a writer repairs or deletes anything."""
    found, path = meta.read_spec(root), root / _REQUEST_FILE
    if found is None:
        return  # `open_writer` refuses it
    earlier = _comparable(json.loads(path.read_bytes()), request) if path.is_file() else None
    count = len(layout.numbered_files(root / "data"))
    if earlier != request and (count or earlier is not None):
        larger = "" if "count" in request else ", ask for the same with a larger count"
        raise _not_resumed(
            "with its own request; this dataset was recorded with another",
            f"Choose another name for the dataset{larger}",
        )
    if found != spec:
        raise _not_resumed(
            "by a version of freerein that stores the same features; this dataset was begun by another",
            "Choose another name for the dataset",
        )
    has_truth = max(truth.stored(root), default=0) > 0  # an append may leave labels of the first
    if not count and (has_truth or (root / labels.FOLDER).exists() or tags.read(root) is not None):
        raise _not_resumed(
            "where its trajectories are; this dataset has labels or tags of trajectories, and none of these",
            "Restore `data/` from a copy, choose another name",
        )


def _comparable(earlier: Mapping[str, Any], request: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a request as it is written now; earlier versions wrote counts of mixes, and conditions in any order."""
    found = {key: value for key, value in earlier.items() if key != "count" or key in request}
    return found | ({"conditions": sorted(found["conditions"])} if "conditions" in found else {})


def _not_resumed(reason: str, ways_out: str) -> FailedPrecondition:
    hint = f"{ways_out}, or delete it: `freerein dataset rm NAME`."
    return FailedPrecondition(f"A recording can be resumed only {reason}.", hint=hint)


def dataset_spec(task: Task, *, cameras: tuple[str, ...], height: int, width: int) -> DatasetSpec:
    """Returns the dataset spec of recordings of a task; without cameras its first, with sizes of 0 the cameras' own.

    Raises InvalidInput for an unknown camera.
    """
    known = {camera.name: camera for camera in task.cameras}
    unknown = [name for name in cameras if name not in known]
    if unknown:
        sentence = f"Cameras must be among the task's, {', '.join(known)}; {len(unknown)} of those asked for are not."
        raise InvalidInput(sentence, field="cameras", hint="Leave them out for the task's first.")
    chosen = [known[name] for name in cameras] or list(task.cameras[:1])
    return DatasetSpec(
        fps=integer_fps(task.control_dt_s),
        cameras={camera.name: (height or camera.height, width or camera.width, camera.channels) for camera in chosen},
        action=task.action,
        robot_type=task.world,
        skills=task.skills,
        task=task.goal_text or task.name,
        has_terminations=True,
        control_dt_s=task.control_dt_s,
    )
