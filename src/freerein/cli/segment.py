"""`freerein segment`: which skill is executed when, in one trajectory of a dataset, or in all of them."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from freerein.cli.output import AsJson, print_json, progress_bar, verb

if TYPE_CHECKING:
    from pathlib import Path

    from freerein.data import Dataset
    from freerein.data.labels import LabelsInfo
    from freerein.types.segmentation import SegmentRequest, SegmentResponse


@verb
def segment(
    dataset: Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")],
    *,
    index: Annotated[int, typer.Option(min=0, help="Which trajectory.")] = 0,
    model: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of the model; the active one when empty.")] = "",
    camera: Annotated[str, typer.Option(help="Whose frames; the dataset's first camera when empty.")] = "",
    smoothing: Annotated[float, typer.Option(min=0, help="Width, in timesteps, of a Gaussian over time.")] = 0.0,
    min_segment: Annotated[int, typer.Option(min=0, help="Merge segments shorter than this many timesteps.")] = 0,
    save: Annotated[bool, typer.Option("--save", help="Label all trajectories, and keep the labels.")] = False,
    as_json: AsJson = False,
) -> None:
    """Label every timestep of a trajectory with a skill; with --save, those of the whole dataset."""
    from freerein.cli.trajectories import choose_camera, root_of
    from freerein.data import Dataset
    from freerein.types.common import ModelRef
    from freerein.types.segmentation import SegmentRequest

    opened = Dataset(root_of(dataset))
    seen = choose_camera(opened, camera)
    request = SegmentRequest(ModelRef(model, version), min_segment=min_segment, smoothing=smoothing)
    if save:
        with progress_bar(f"labelling {dataset}", total=len(opened), is_shown=not as_json) as on_count:
            info = asyncio.run(_save(root_of(dataset), request, seen, on_count))
        _show_saved(dataset, len(opened), info, as_json=as_json)
    else:
        _segment_one(opened, index, request, seen, as_json=as_json)


def _segment_one(dataset: "Dataset", index: int, request: "SegmentRequest", camera: str, *, as_json: bool) -> None:
    from dataclasses import replace

    from freerein import wire
    from freerein.cli.segment_picture import show
    from freerein.cli.trajectories import trajectory

    chosen = trajectory(dataset, index)
    answer = asyncio.run(_ask(replace(request, frames=chosen.frames[camera], actions=chosen.actions)))
    print_json(wire.to_json(answer)) if as_json else show(answer)


async def _ask(request: "SegmentRequest") -> "SegmentResponse":
    from freerein.cli.connection import connect
    from freerein.clients import SegmentationClient

    async with connect(SegmentationClient, "segmentation") as client:
        return await client.segment(request)


async def _save(root: "Path", request: "SegmentRequest", camera: str, on_count: Callable[[int], None]) -> "LabelsInfo":
    from freerein.cli.connection import connect
    from freerein.cli.labelling import label_all
    from freerein.clients import SegmentationClient

    async with connect(SegmentationClient, "segmentation") as client:
        return await label_all(client, root, request, camera=camera, on_count=on_count)


def _show_saved(dataset: str, count: int, info: "LabelsInfo", *, as_json: bool) -> None:
    if as_json:
        model = {"name": info.model.name, "version": info.model.version}
        print_json({"dataset": dataset, "labelled": count, "skills": list(info.skills), "model": model})
    else:
        typer.echo(f"{count} trajectories of {dataset} are labelled, by model {info.model.name} {info.model.version}.")
