"""Looks up a task of the sim service, and a camera of a task, by name."""

from freerein.clients.sync_client import SyncClient
from freerein.errors import NotFound, must_be, quoted
from freerein.types.common import Camera
from freerein.types.sim import ListTasksRequest, ListTasksResponse, Task


def find_task(sim: SyncClient, name: str, *, field: str = "config.task") -> Task:
    """Returns the sim service's task of that name. Raises NotFound if there is none."""
    return select_task(sim.list_tasks(ListTasksRequest()), name, field=field)


def select_task(tasks: ListTasksResponse, name: str, *, field: str = "task") -> Task:
    """Returns the task of that name. Raises NotFound if there is none."""
    for task in tasks.tasks:
        if task.name == name:
            return task
    raise NotFound(
        f"`{field}` must name one of the sim service's {len(tasks.tasks)} tasks; got {quoted(name)}.",
        field=field,
        hint="`freerein sim tasks` lists them.",
    )


def find_camera(task: Task, name: str, *, field: str = "config.camera") -> Camera:
    """Returns the task's camera of that name, its first for an empty one. Raises InvalidInput if there is none."""
    cameras = {camera.name: camera for camera in task.cameras}
    if name and name not in cameras:
        hint = "Leave it out for the first."
        raise must_be("`camera`", f"one of the task's, {', '.join(cameras)}", quoted(name), field=field, hint=hint)
    return cameras[name] if name else task.cameras[0]
