"""`freerein reward`: how well images show what a goal text says, and where in an image things are."""

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from freerein.cli.image_files import FILES, read_images
from freerein.cli.output import AsJson, print_json, show_table, verb
from freerein.errors import InvalidInput

if TYPE_CHECKING:
    from freerein.types.common import Image
    from freerein.types.reward import Grounding, RewardRequest, RewardResponse

_IMAGES_AT_ONCE = 16
_BYTES_AT_ONCE = 32 * 2**20

_Images = Annotated[list[str] | None, typer.Argument(metavar=FILES, help="Images, or folders of frames in order.")]
_Rivals = Annotated[
    list[str] | None, typer.Option(help="A text to beat; the goal with every other relation when none is given.")
]
_Heatmap = Annotated[
    Path | None, typer.Option(metavar="OUT.png", help="Draw where each --phrase is in the first image.")
]
_Phrases = Annotated[list[str] | None, typer.Option(help="A noun phrase to look for, such as `a red block`.")]


@verb
def reward(
    image: _Images = None,
    *,
    goal: Annotated[str, typer.Option(help="What is to be seen.")],
    rival: _Rivals = None,
    raw: Annotated[bool, typer.Option("--raw", help="The similarity itself, not whether the goal wins.")] = False,
    dataset: Annotated[str, typer.Option(help="Take a trajectory of this dataset instead of images.")] = "",
    index: Annotated[int, typer.Option(min=0, help="Which trajectory of the dataset.")] = 0,
    model: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of the model; the active one when empty.")] = "",
    heatmap: _Heatmap = None,
    phrase: _Phrases = None,
    as_json: AsJson = False,
) -> None:
    """Reward images for showing what a goal text says."""
    from freerein import wire
    from freerein.types.common import ModelRef
    from freerein.types.reward import RewardRequest

    _check(image, dataset, heatmap, phrase)
    asked = RewardRequest(
        goal_text=goal, rivals=tuple(rival or ()), mode="raw" if raw else "binary", model=ModelRef(model, version)
    )
    parts = list(_from_dataset(asked, dataset, index) if dataset else _from_files(asked, image or ()))
    answers = asyncio.run(_ask(parts))
    answer = _joined(answers)
    print_json(wire.to_json(answer)) if as_json else _show(answer)
    if heatmap:
        groundings = _draw(parts[0], tuple(phrase or ()), heatmap)
        _show_places(groundings, heatmap, as_json=as_json)


def _check(image: list[str] | None, dataset: str, heatmap: Path | None, phrase: list[str] | None) -> None:
    if bool(image) == bool(dataset):
        raise InvalidInput(
            f"Exactly one of images and a dataset must be named; got {'both' if dataset else 'neither'}.",
            field="image",
            hint="Write freerein reward now.png --goal '...', or --dataset NAME --index I.",
        )
    if bool(heatmap) != bool(phrase):
        raise InvalidInput(
            f"A picture of heatmaps needs both --heatmap and --phrase; got {'no phrase' if heatmap else 'no file'}.",
            field="heatmap",
            hint="Write --heatmap out.png --phrase 'a red block'.",
        )
    if heatmap and heatmap.suffix.lower() != ".png":
        raise InvalidInput(
            "The picture of heatmaps is a PNG; got a name that ends otherwise.",
            field="heatmap",
            hint="End the name in .png.",
        )


def _from_files(asked: "RewardRequest", named: Sequence[str]) -> "Iterator[RewardRequest]":
    """Yields requests of a few moments each, with the images of every camera."""
    from dataclasses import replace

    by_camera: dict[str, list[Image]] = {}
    for one in read_images(named):
        by_camera.setdefault(one.camera, []).append(one)
    longest = max(map(len, by_camera.values()))
    for start in range(0, longest, _IMAGES_AT_ONCE):
        some = tuple(one for own in by_camera.values() for one in own[start : start + _IMAGES_AT_ONCE])
        yield replace(asked, images=some)


def _from_dataset(asked: "RewardRequest", name: str, index: int) -> "Iterator[RewardRequest]":
    """Yields requests that hold the frames of a trajectory, from every camera, in parts that fit into a message."""
    from dataclasses import replace

    from freerein.cli.trajectories import root_of, trajectory
    from freerein.data import Dataset

    frames = trajectory(Dataset(root_of(name)), index).frames
    moments = next(iter(frames.values())).shape[0]
    at_once = max(1, _BYTES_AT_ONCE * moments // sum(array.nbytes for array in frames.values()))
    for start in range(0, moments, at_once):
        yield replace(asked, frames={camera: array[start : start + at_once] for camera, array in frames.items()})


async def _ask(parts: "Sequence[RewardRequest]") -> "list[RewardResponse]":
    from freerein.cli.connection import connect
    from freerein.clients import RewardClient

    async with connect(RewardClient, "reward") as client:
        return [await client.reward(part) for part in parts]


def _draw(first: "RewardRequest", phrases: tuple[str, ...], path: Path) -> "tuple[Grounding, ...]":
    """Writes the picture of where phrases are in the first image; returns where they are."""
    from freerein import images
    from freerein.cli.heatmap_picture import draw

    image = first.images[0] if first.images else images.encode(next(iter(first.frames.values()))[0])
    groundings = asyncio.run(_ground(image, phrases))
    path.write_bytes(images.encode(draw(images.decode(image), groundings)).data)
    return groundings


async def _ground(image: "Image", phrases: tuple[str, ...]) -> "tuple[Grounding, ...]":
    from freerein.cli.connection import connect
    from freerein.clients import RewardClient
    from freerein.types.reward import GroundRequest

    async with connect(RewardClient, "reward") as client:
        return (await client.ground(GroundRequest(image, phrases))).groundings


def _joined(answers: "Sequence[RewardResponse]") -> "RewardResponse":
    """Returns the answers to the parts of one request as one."""
    from dataclasses import replace

    import numpy as np

    return replace(
        answers[0],
        rewards=np.concatenate([answer.rewards for answer in answers]),
        similarities=np.concatenate([answer.similarities for answer in answers]),
        winners=np.concatenate([answer.winners for answer in answers]),
    )


def _show(answer: "RewardResponse") -> None:
    rows = [
        (str(moment), f"{reward:.3g}", f"{similarity:.3f}", answer.texts[winner])
        for moment, (reward, similarity, winner) in enumerate(
            zip(answer.rewards, answer.similarities, answer.winners, strict=True)
        )
    ]
    show_table(("frame", "reward", "similarity", "fits best"), rows)
    typer.echo(f"{len(rows)} frames, model {answer.model.name} {answer.model.version}")
    if answer.unknown_words:
        typer.echo(f"{answer.unknown_words} words of the goal are new to the model: its rewards are a guess.")
    if answer.truncated:
        typer.echo("A text was too long for the model and was cut.")


def _show_places(groundings: "Sequence[Grounding]", path: Path, *, as_json: bool) -> None:
    places = [{"phrase": found.phrase, "x": found.x, "y": found.y, "presence": found.presence} for found in groundings]
    if as_json:
        print_json({"heatmap": str(path), "groundings": places})
        return
    rows = [(found.phrase, f"{found.x:.1f}", f"{found.y:.1f}", f"{found.presence:.2f}") for found in groundings]
    show_table(("phrase", "x", "y", "presence"), rows)
    typer.echo(f"Drawn in {path}.")
