"""Records the sim service's demonstrations into a dataset, and goes on where an earlier recording stopped.

<root>/recording.json   what was asked for: only the same request, with any count, may go on
"""

import json
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import replace
from pathlib import Path

from freerein import wire
from freerein.cli.streams import unbroken
from freerein.clients import SimClient
from freerein.data import DatasetSpec, Writer, create, integer_fps, open_writer
from freerein.durable import write_durably
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, Unavailable
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksRequest, Task

_REQUEST = "recording.json"


async def record(client: SimClient, request: DemonstrateRequest, root: Path, *, on_count: Callable[[int], None]) -> int:
    """Makes a dataset hold the `request.count` demonstrations of a request. Those it holds already stay.

    Args:
        client: The sim service.
        request: What to demonstrate; `first` is ours to choose.
        root: Where the dataset lies, or will lie.
        on_count: Called with the number of trajectories on disk, at first and after each one.

    Returns:
        How many trajectories the dataset holds.

    Raises:
        FailedPrecondition: The dataset holds something else.
        ServiceError: The service refused, or went away for good.
    """
    task = await _find_task(client, request.task)
    with _open(root, request, task) as writer:
        on_count(len(writer))
        if len(writer) < request.count:
            async with aclosing(unbroken(lambda: _rest(client, request, writer))) as demonstrations:
                async for demonstration in demonstrations:
                    labels = demonstration.labels if request.privileged else None
                    on_count(writer.append(demonstration.trajectory, labels) + 1)
        return len(writer)


async def _rest(
    client: SimClient, request: DemonstrateRequest, writer: Writer
) -> AsyncGenerator[DemonstrateResponse, None]:
    """Yields the demonstrations that a dataset does not hold yet."""
    async with aclosing(client.demonstrate(replace(request, first=len(writer)))) as demonstrations:
        async for demonstration in demonstrations:
            yield demonstration
    if len(writer) < request.count:
        raise Unavailable("The stream of demonstrations must be whole; it ended early.", hint="Record again to go on.")


async def _find_task(client: SimClient, name: str) -> Task:
    tasks = {task.name: task for task in (await client.list_tasks(ListTasksRequest())).tasks}
    if name not in tasks:
        raise NotFound(
            f"The task must be one of the {len(tasks)} that the sim service has; got another name.",
            field="task",
            hint="`freerein sim tasks` names them.",
        )
    return tasks[name]


def _open(root: Path, request: DemonstrateRequest, task: Task) -> Writer:
    asked = {key: value for key, value in wire.to_json(request).items() if key not in ("count", "first")}
    writer = open_writer(root) if root.exists() else create(root, _spec(request, task))
    try:
        recorded = _recorded(root)
        if len(writer) and recorded != asked:
            raise FailedPrecondition(
                "A recording can only go on with the request that began it; this dataset was recorded with another.",
                hint="Choose another name for the dataset, or ask for the same with a larger count.",
            )
        if recorded != asked:
            write_durably(root / _REQUEST, json.dumps(asked).encode())
    except BaseException:
        writer.close()
        raise
    return writer


def _recorded(root: Path) -> object:
    path = root / _REQUEST
    return json.loads(path.read_bytes()) if path.is_file() else None


def _spec(request: DemonstrateRequest, task: Task) -> DatasetSpec:
    cameras = {camera.name: camera for camera in task.cameras}
    unknown = [name for name in request.cameras if name not in cameras]
    if unknown:
        raise InvalidInput(
            f"Cameras must be among the task's, {', '.join(cameras)}; {len(unknown)} of those asked for are not.",
            field="cameras",
            hint="Leave them out for the task's first.",
        )
    chosen = [cameras[name] for name in request.cameras] or list(task.cameras[:1])
    return DatasetSpec(
        fps=integer_fps(task.control_dt_s),
        cameras={
            camera.name: (request.height or camera.height, request.width or camera.width, camera.channels)
            for camera in chosen
        },
        action=task.action,
        robot_type=task.world,
        skills=task.skills,
        task=task.goal_text or task.name,
    )
