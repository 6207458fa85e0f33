"""`freerein sim`: lists simulated tasks and records demonstrations into datasets."""

from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from freerein import wire
from freerein.cli.connection import call
from freerein.cli.datasets import Replace, dataset_root, replaceable_root
from freerein.cli.jobs.streams import reconnecting
from freerein.cli.output import AsJson, command, print_json, progress_bar
from freerein.cli.tables import show_table
from freerein.clients import SimClient
from freerein.data.dataset_recorder import DatasetRecorder
from freerein.types.sim import DemonstrateRequest, DemonstrateResponse, ListTasksRequest, Task

app = typer.Typer(help="List simulated tasks and record demonstrations.", no_args_is_help=True, add_completion=False)


@app.command()
@command
def tasks(as_json: AsJson = False) -> None:
    """List the tasks."""
    found = call(SimClient, "sim", lambda client: client.list_tasks(ListTasksRequest()))
    if as_json:
        print_json(wire.to_json(found))
        return
    columns = ("task", "cameras", "action", "rate", "skills")
    show_table(columns, [_row(task) for task in found.tasks], last="cut")


@app.command()
@command
def demonstrate(
    task: Annotated[str, typer.Argument(help="Name of the task; see `freerein sim tasks`.")],
    *,
    out: Annotated[str, typer.Option(help="Name of the dataset; an unfinished recording is continued.")],
    count: Annotated[int, typer.Option(min=1, help="Number of trajectories in the dataset.")] = 100,
    skill: Annotated[list[str] | None, typer.Option(help="Allowed skill; repeatable. All by default.")] = None,
    min_skills: Annotated[int, typer.Option(min=0, help="Fewest different skills per trajectory; 0: the task's.")] = 0,
    max_skills: Annotated[int, typer.Option(min=0, help="Most different skills per trajectory; 0: the task's.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Random seed.")] = 0,
    camera: Annotated[list[str] | None, typer.Option(help="Camera; repeatable. The first by default.")] = None,
    height: Annotated[int, typer.Option(min=0, help="Frame height in pixels; 0 means the camera's.")] = 0,
    width: Annotated[int, typer.Option(min=0, help="Frame width in pixels; 0 means the camera's.")] = 0,
    behaviour: Annotated[Literal["expert", "random"], typer.Option(help="Who chooses the actions.")] = "expert",
    condition: Annotated[
        list[str] | None, typer.Option(help="Condition of the task; repeatable. None by default.")
    ] = None,
    truth: Annotated[bool, typer.Option("--truth", help="Store true labels beside the data, for evaluation.")] = False,
    replace: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Record demonstrations of a task into a dataset."""
    request = DemonstrateRequest(
        task=task,
        behaviour=behaviour,
        skills=tuple(skill or ()),
        min_skills=min_skills,
        max_skills=max_skills,
        count=count,
        seed=seed,
        cameras=tuple(camera or ()),
        height=height,
        width=width,
        privileged=truth,
        conditions=tuple(condition or ()),
    )
    root, check = (replaceable_root if replace else dataset_root)(out), partial(replaceable_root, out)
    with progress_bar(f"recording {out}", total=count, is_shown=not as_json) as on_count:

        async def use(client: SimClient) -> int:
            return await record(client, request, root, replaces=replace, check_unused=check, on_count=on_count)

        held = call(SimClient, "sim", use)
    if as_json:
        print_json({"dataset": out, "trajectories": held})
    else:
        typer.echo(f"The dataset {out} holds {held} {'trajectory' if held == 1 else 'trajectories'}.")


async def record(
    client: SimClient,
    request: DemonstrateRequest,
    root: Path,
    *,
    replaces: bool = False,
    check_unused: Callable[[], object] = lambda: None,
    on_count: Callable[[int], None],
) -> int:
    """Records demonstrations until a dataset holds `request.count`; trajectories that it holds already stay.

    With `replaces` they go once all new ones are there, unless `check_unused` raises.

    Returns the number of trajectories in the dataset, with which `on_count` is called at the start and after each one.
    Raises FailedPrecondition where the dataset was recorded with other options.
    """
    tasks = await client.list_tasks(ListTasksRequest())
    with DatasetRecorder(root, request, tasks, replaces=replaces, check_unused=check_unused) as recording:
        on_count(len(recording))
        if not recording.is_complete:
            async with aclosing(reconnecting(lambda: _rest(client, recording))) as demonstrations:
                async for demonstration in demonstrations:
                    recording.append(demonstration)
                    on_count(len(recording))
        return len(recording)


async def _rest(client: SimClient, recording: DatasetRecorder) -> AsyncGenerator[DemonstrateResponse, None]:
    """Yields the demonstrations that the dataset does not hold yet."""
    async with aclosing(client.demonstrate(recording.remaining)) as demonstrations:
        async for demonstration in demonstrations:
            yield demonstration
    recording.check_complete()


def _row(task: Task) -> tuple[str, ...]:
    by_size: dict[str, list[str]] = {}
    for camera in task.cameras:
        by_size.setdefault(f"{camera.height}x{camera.width}", []).append(camera.name)
    cameras = ", ".join(f"{', '.join(names)} {size}" for size, names in by_size.items())
    action = f"{task.action.choices} choices" if task.action.choices else f"{task.action.size} numbers"
    return task.name, cameras, action, f"{1 / task.control_dt_s:g} Hz", ", ".join(task.skills)
