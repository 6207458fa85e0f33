"""`freerein segment`: labels the timesteps of one trajectory, or of a whole dataset, with skills."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from string import ascii_uppercase
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from freerein import wire
from freerein.cli.commands.dataset import camera_or_first, dataset_root, read_trajectory
from freerein.cli.connection import call
from freerein.cli.output import AsJson, command, print_json, progress_bar
from freerein.clients import SegmentationClient
from freerein.data import Dataset, labels
from freerein.data.labels import LabelsInfo
from freerein.types.common import ModelRef
from freerein.types.segmentation import NO_SKILL, ListSkillsRequest, SegmentRequest, SegmentResponse

_COLOURS = ("cyan", "magenta", "yellow", "green", "blue", "red", "bright_cyan", "bright_magenta")
_WIDEST_BAR = 100

app = typer.Typer(add_completion=False)


@app.command()
@command
def segment(
    dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
    *,
    index: Annotated[int, typer.Option(min=0, help="Index of the trajectory.")] = 0,
    model: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of the model; the active one by default.")] = "",
    camera: Annotated[str, typer.Option(help="Camera of the frames; the dataset's first by default.")] = "",
    smoothing: Annotated[float, typer.Option(min=0, help="Standard deviation of smoothing, in timesteps.")] = 0.0,
    min_segment: Annotated[int, typer.Option(min=0, help="Merge segments shorter than this many timesteps.")] = 0,
    min_kept: Annotated[int, typer.Option(min=0, help="Reject segments shorter than this many timesteps.")] = 0,
    save: Annotated[bool, typer.Option("--save", help="Label the whole dataset and store the labels.")] = False,
    as_json: AsJson = False,
) -> None:
    """Label every timestep of a trajectory with a skill; with --save, of the whole dataset."""
    opened = Dataset(dataset_root(dataset))
    chosen = camera_or_first(opened, camera)
    request = SegmentRequest(ModelRef(model, version), min_segment=min_segment, smoothing=smoothing, min_kept=min_kept)
    if save:
        with progress_bar(f"labelling {dataset}", total=len(opened), is_shown=not as_json) as on_count:
            info = call(
                SegmentationClient,
                "segmentation",
                lambda client: label_all(client, dataset_root(dataset), request, camera=chosen, on_count=on_count),
            )
        _show_saved(dataset, len(opened), info, as_json=as_json)
    else:
        _segment_one(opened, index, request, chosen, as_json=as_json)


def _segment_one(dataset: Dataset, index: int, request: SegmentRequest, camera: str, *, as_json: bool) -> None:
    trajectory = read_trajectory(dataset, index)
    filled = replace(request, frames=trajectory.frames[camera], actions=trajectory.actions)
    answer = call(SegmentationClient, "segmentation", lambda client: client.segment(filled))
    print_json(wire.to_json(answer)) if as_json else _show(answer)


def _show_saved(dataset: str, count: int, info: LabelsInfo, *, as_json: bool) -> None:
    if as_json:
        model = {"name": info.model.name, "version": info.model.version}
        print_json({"dataset": dataset, "labelled": count, "skills": list(info.skills), "model": model})
    else:
        typer.echo(f"Labelled {count} trajectories of {dataset} by model {info.model.name} {info.model.version}.")


async def label_all(
    client: SegmentationClient,
    root: Path,
    request: SegmentRequest,
    *,
    camera: str,
    on_count: Callable[[int], None],
) -> LabelsInfo:
    """Labels every trajectory of a dataset by one version of a model, and stores the labels beside it.

    The labels count only once all trajectories have theirs. `request` holds model and options; `on_count` is called
    with the number of trajectories labelled.
    """
    skills = await client.list_skills(ListSkillsRequest(request.model))
    labels.discard(root)
    for index, trajectory in enumerate(Dataset(root)):
        frames, actions = trajectory.frames[camera], trajectory.actions
        answer = await client.segment(replace(request, model=skills.model, frames=frames, actions=actions))
        labels.save(root, index, answer.labels)
        on_count(index + 1)
    info = labels.LabelsInfo(skills.skills, skills.model)
    labels.finish(root, info)
    return info


def _show(answer: SegmentResponse) -> None:
    """Prints the segments as a table, and the trajectory as a bar."""
    console = Console()
    table = Table("", "skill", "from", "to", "confidence", box=None, header_style="bold", pad_edge=False)
    for segment in answer.segments:
        mark = _mark(answer.skills.index(segment.skill))
        table.add_row(mark, Text(segment.skill), str(segment.start), str(segment.end), f"{segment.confidence:.2f}")
    console.print(table)
    console.print(skill_bar([int(label) for label in answer.labels], width=min(console.width, _WIDEST_BAR)))
    console.print(f"{len(answer.labels)} timesteps, model {answer.model.name} {answer.model.version}", style="dim")


def skill_bar(labels: Sequence[int], *, width: int) -> Text:
    """Returns a trajectory as a line of at most `width` letters: A in its own colour for skill 0, a dot for none."""
    cells = min(width, len(labels))
    return Text.assemble(*(_mark(labels[cell * len(labels) // cells]) for cell in range(cells)))


def _mark(skill: int) -> Text:
    if skill == NO_SKILL:
        return Text("·", style="dim")
    return Text(ascii_uppercase[skill % len(ascii_uppercase)], style=f"black on {_COLOURS[skill % len(_COLOURS)]}")
