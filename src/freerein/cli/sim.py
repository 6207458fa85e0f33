"""`freerein sim`: the simulated worlds, and demonstrations recorded in them."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from freerein.cli.output import AsJson, print_json, progress_bar, show_table, verb

if TYPE_CHECKING:
    from freerein.types.sim import DemonstrateRequest, ListTasksResponse, Task

app = typer.Typer(help="Simulated worlds: their tasks, and demonstrations recorded in them.", no_args_is_help=True)


@app.command()
@verb
def tasks(as_json: AsJson = False) -> None:
    """List the tasks."""
    from freerein import wire

    found = asyncio.run(_list_tasks())
    if as_json:
        print_json(wire.to_json(found))
        return
    columns = ("task", "world", "cameras", "action", "rate", "skills")
    show_table(columns, [_row(task) for task in found.tasks])


@app.command()
@verb
def demonstrate(
    task: Annotated[str, typer.Argument(help="What `freerein sim tasks` lists.")],
    *,
    out: Annotated[str, typer.Option(help="The dataset's name. One that was begun alike is gone on with.")],
    count: Annotated[int, typer.Option(min=1, help="Trajectories that the dataset is to hold.")] = 100,
    skill: Annotated[list[str] | None, typer.Option(help="Skills to choose from; all when none is named.")] = None,
    min_skills: Annotated[int, typer.Option(min=0, help="Fewest different skills in one; 0 means 1.")] = 0,
    max_skills: Annotated[int, typer.Option(min=0, help="Most different skills in one; 0 means all.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Where all draws come from.")] = 0,
    camera: Annotated[list[str] | None, typer.Option(help="Cameras to record; the first when none is named.")] = None,
    height: Annotated[int, typer.Option(min=0, help="Of the frames, in pixels; 0 means the camera's own.")] = 0,
    width: Annotated[int, typer.Option(min=0, help="Of the frames, in pixels; 0 means the camera's own.")] = 0,
    behaviour: Annotated[Literal["expert", "random"], typer.Option(help="Who acts.")] = "expert",
    truth: Annotated[bool, typer.Option("--truth", help="Keep true labels beside the data, for evaluation.")] = False,
    as_json: AsJson = False,
) -> None:
    """Record demonstrations of a task into a dataset."""
    from freerein.types.sim import DemonstrateRequest

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
    )
    with progress_bar(f"recording {out}", total=count, is_shown=not as_json) as on_count:
        held = asyncio.run(_record(request, out, on_count))
    if as_json:
        print_json({"dataset": out, "trajectories": held})
    else:
        typer.echo(f"The dataset {out} holds {held} trajectories.")


async def _list_tasks() -> "ListTasksResponse":
    from freerein.cli.connection import connect
    from freerein.clients import SimClient
    from freerein.types.sim import ListTasksRequest

    async with connect(SimClient, "sim") as client:
        return await client.list_tasks(ListTasksRequest())


async def _record(request: "DemonstrateRequest", dataset: str, on_count: Callable[[int], None]) -> int:
    from freerein.cli.connection import connect
    from freerein.cli.recording import record
    from freerein.cli.settings import CliSettings
    from freerein.clients import SimClient
    from freerein.data import dataset_path

    root = dataset_path(CliSettings().data_dir, dataset)
    async with connect(SimClient, "sim") as client:
        return await record(client, request, root, on_count=on_count)


def _row(task: "Task") -> tuple[str, ...]:
    cameras = ", ".join(f"{camera.name} {camera.height}x{camera.width}" for camera in task.cameras)
    action = f"{task.action.choices} choices" if task.action.choices else f"{task.action.size} numbers"
    return task.name, task.world, cameras, action, f"{1 / task.control_dt_s:g} Hz", ", ".join(task.skills)
