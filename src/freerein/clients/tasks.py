"""Looks up a task of the sim service by its name."""

from freerein.clients.sync_client import SyncClient
from freerein.errors import NotFound
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
        f"`{field}` must name one of the sim service's {len(tasks.tasks)} tasks; got another name.",
        field=field,
        hint="`freerein sim tasks` lists them.",
    )
