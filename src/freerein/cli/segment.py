"""`freerein segment`: which skill is executed when, in one trajectory of a dataset."""

import asyncio
from typing import TYPE_CHECKING, Annotated

import typer

from freerein.cli.output import AsJson, print_json, verb
from freerein.errors import InvalidInput, NotFound

if TYPE_CHECKING:
    from freerein.data import Dataset
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
    as_json: AsJson = False,
) -> None:
    """Label every timestep of a trajectory with a skill."""
    from freerein import wire
    from freerein.cli.segment_picture import show
    from freerein.cli.settings import CliSettings
    from freerein.data import Dataset, dataset_path
    from freerein.types.common import ModelRef
    from freerein.types.segmentation import SegmentRequest

    opened = Dataset(dataset_path(CliSettings().data_dir, dataset))
    _check_index(index, len(opened))
    trajectory = opened[index]
    request = SegmentRequest(
        model=ModelRef(model, version),
        frames=trajectory.frames[_camera(opened, camera)],
        actions=trajectory.actions,
        min_segment=min_segment,
        smoothing=smoothing,
    )
    answer = asyncio.run(_ask(request))
    print_json(wire.to_json(answer)) if as_json else show(answer)


async def _ask(request: "SegmentRequest") -> "SegmentResponse":
    from freerein.cli.connection import open_channel
    from freerein.cli.settings import CliSettings
    from freerein.clients import SegmentationClient

    async with SegmentationClient(open_channel("segmentation", CliSettings())) as client:
        return await client.segment(request)


def _check_index(index: int, count: int) -> None:
    if index >= count:
        raise NotFound(
            f"The dataset holds {count} trajectories, counted from 0; got {index}.",
            field="index",
            hint="`freerein dataset inspect` says what it holds.",
        )


def _camera(dataset: "Dataset", camera: str) -> str:
    cameras = tuple(dataset.spec.cameras)
    if camera and camera not in cameras:
        raise InvalidInput(
            f"The camera must be one of {', '.join(cameras)}; got another name.",
            field="camera",
            hint="Leave it out for the first.",
        )
    return camera or cameras[0]
