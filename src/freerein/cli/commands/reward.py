"""`freerein reward`: rewards images against a goal text, and finds noun phrases in them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from freerein import images, wire
from freerein.cli.audit import Audit, read_answers
from freerein.cli.audit import audit as run_audit
from freerein.cli.audit import show as show_audit
from freerein.cli.commands.image_files import FILES, read_images
from freerein.cli.connection import call
from freerein.cli.datasets import dataset_root, read_trajectory
from freerein.cli.output import AsJson, command, print_json
from freerein.cli.tables import show_table
from freerein.clients import RewardClient
from freerein.clients.request_slices import request_slices
from freerein.data import Dataset
from freerein.errors import must_be, quoted
from freerein.types.common import Image, ModelRef
from freerein.types.reward import Grounding, GroundRequest, GroundResponse, RewardRequest, RewardResponse

_BYTES_PER_REQUEST = 32 * 2**20
_DARK, _LIGHT, _GAP = 0.35, (255, 170, 40), 4

_Images = Annotated[list[str] | None, typer.Argument(metavar=FILES, help="Image files, or folders of frames in order.")]
_Rivals = Annotated[
    list[str] | None, typer.Option(help="Rival text; repeatable. By default the goal with every other relation.")
]
_Heatmap = Annotated[
    Path | None,
    typer.Option(metavar="OUT.png", help="Draw where the grounding model sees each --phrase in the first image."),
]
_Phrases = Annotated[list[str] | None, typer.Option(help="Noun phrase to find, such as `a red block`; repeatable.")]

app = typer.Typer(add_completion=False)


@app.command()
@command
def reward(
    image: _Images = None,
    *,
    goal: Annotated[str, typer.Option(help="Goal text; needed without --audit and --heatmap.")] = "",
    rival: _Rivals = None,
    raw: Annotated[bool, typer.Option("--raw", help="Return the similarity instead of 0 or 1.")] = False,
    dataset: Annotated[str, typer.Option(help="Reward a trajectory of this dataset instead of images.")] = "",
    index: Annotated[int | None, typer.Option(min=0, help="Index of the trajectory; the first by default.")] = None,
    model: Annotated[str, typer.Option(help="Name of the reward model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of that model; the active one by default.")] = "",
    heatmap: _Heatmap = None,
    phrase: _Phrases = None,
    audit: Audit = None,
    as_json: AsJson = False,
) -> None:
    """Reward images against a goal text."""
    if audit:
        _check_alone(image, dataset, goal, rival, raw, heatmap, phrase, index is not None)
        show_audit(run_audit(read_answers(audit), ModelRef(model, version)), as_json=as_json)
        return
    _check_source(image, dataset, index)
    _check_drawing(heatmap, phrase)
    if not goal and (rival or raw or not heatmap):
        hint = "Write freerein reward now.png --goal 'a red block on top of a blue block'."
        raise must_be("--goal", "given", "none", field="goal", hint=hint)
    asked = RewardRequest(
        goal_text=goal, rivals=tuple(rival or ()), mode="raw" if raw else "binary", model=ModelRef(model, version)
    )
    parts = list(_from_dataset(asked, dataset, index or 0) if dataset else _from_files(asked, image or ()))
    if goal:
        answer = _joined(call(RewardClient, "reward", lambda client: _ask(client, parts)))
        print_json(wire.to_json(answer)) if as_json else _show(answer, is_raw=raw)
    if heatmap:
        _show_places(_draw(parts[0], tuple(phrase or ()), heatmap), heatmap, as_json=as_json)


def _check_alone(*others: object) -> None:
    if any(others):
        hint = "Leave out images and other options but --model and --version: the folder has images and texts."
        raise must_be("--audit", "given alone", "more", field="audit", hint=hint)


def _check_source(image: list[str] | None, dataset: str, index: int | None) -> None:
    if bool(image) == bool(dataset):
        name, hint = (
            "Exactly one of images and a dataset",
            "Write freerein reward now.png --goal '...', or --dataset NAME.",
        )
        raise must_be(name, "given", "both" if dataset else "neither", field="image", hint=hint)
    if index is not None and not dataset:
        raise must_be("--index", "given with --dataset", "images", field="index", hint="Leave it out.")


def _check_drawing(heatmap: Path | None, phrase: list[str] | None) -> None:
    if bool(heatmap) != bool(phrase):
        found, hint = "no phrase" if heatmap else "no file", "Write --heatmap out.png --phrase 'a red block'."
        raise must_be("--heatmap and --phrase", "given together", found, field="heatmap", hint=hint)
    if heatmap and heatmap.suffix.lower() != ".png":
        raise must_be("heatmap", "a .png file", quoted(heatmap.name), hint="Write --heatmap out.png.")


def _from_files(asked: RewardRequest, named: Sequence[str]) -> Iterator[RewardRequest]:
    """Yields requests of a few timesteps each, with the images of all cameras."""
    by_camera: dict[str, list[Image]] = {}
    for one in read_images(named):
        by_camera.setdefault(one.camera, []).append(one)
    counts = {camera: len(own) for camera, own in by_camera.items()}
    if len(set(counts.values())) > 1:
        got = ", ".join(f"{count} of {camera or 'no camera'}" for camera, count in counts.items())
        hint = "Name one of each camera for every moment: front=FOLDER left=FOLDER."
        raise must_be("Every camera", "given the same number of images", got, field="image", hint=hint)
    moments = list(zip(*by_camera.values(), strict=True))
    for part in request_slices(moments):
        yield replace(asked, images=tuple(chain.from_iterable(moments[part])))


def _from_dataset(asked: RewardRequest, name: str, index: int) -> Iterator[RewardRequest]:
    """Yields requests with the frames of a trajectory from all cameras, each small enough for a message."""
    frames = read_trajectory(Dataset(dataset_root(name)), index).frames
    timesteps = next(iter(frames.values())).shape[0]
    per_request = max(1, _BYTES_PER_REQUEST * timesteps // sum(array.nbytes for array in frames.values()))
    for start in range(0, timesteps, per_request):
        yield replace(asked, frames={camera: array[start : start + per_request] for camera, array in frames.items()})


async def _ask(client: RewardClient, parts: Sequence[RewardRequest]) -> list[RewardResponse]:
    return [await client.reward(part) for part in parts]


def _draw(first: RewardRequest, phrases: tuple[str, ...], path: Path) -> GroundResponse:
    """Writes the heatmaps of phrases in the first image; returns where they are."""
    image = first.images[0] if first.images else images.encode(next(iter(first.frames.values()))[0])
    found = call(RewardClient, "reward", lambda client: client.ground(GroundRequest(image, phrases)))
    path.write_bytes(images.encode(_heatmaps(images.decode(image), found.groundings)).data)
    return found


def _heatmaps(image: npt.NDArray[np.uint8], groundings: Sequence[Grounding]) -> npt.NDArray[np.uint8]:
    """Returns an image uint8 (H, W, 1 or 3) beside a heatmap for each phrase, uint8 (H, W', 3)."""
    colour = np.broadcast_to(image, (*image.shape[:2], 3))
    gap = np.full((image.shape[0], _GAP, 3), 255, np.uint8)
    panels = [colour, *(panel for grounding in groundings for panel in (gap, _lit(colour, grounding)))]
    return np.concatenate(panels, axis=1)


def _lit(image: npt.NDArray[np.uint8], grounding: Grounding) -> npt.NDArray[np.uint8]:
    """Returns the image darkened outside the heatmap, with a cross at the phrase's pixel."""
    heat = grounding.heatmap[:, :, np.newaxis]
    lit = image * (_DARK + (1 - _DARK) * heat) * (1 - heat / 2) + np.array(_LIGHT, np.float32) * (heat / 2)
    height, width = image.shape[:2]
    x, y = min(int(grounding.x), width - 1), min(int(grounding.y), height - 1)
    arm = max(1, min(height, width) // 20)
    lit[y, max(0, x - arm) : x + arm + 1] = 255
    lit[max(0, y - arm) : y + arm + 1, x] = 255
    return lit.astype(np.uint8)


def _joined(answers: Sequence[RewardResponse]) -> RewardResponse:
    """Returns the answers to parts of a request as one answer."""
    names = ("rewards", "similarities", "winners", "in_distribution")
    joined: Any = {name: np.concatenate([getattr(answer, name) for answer in answers]) for name in names}
    return replace(answers[0], **joined)


def _show(answer: RewardResponse, *, is_raw: bool) -> None:
    rows = [
        (str(moment), f"{reward:.3g}", f"{similarity:.3f}", answer.texts[winner])
        for moment, (reward, similarity, winner) in enumerate(
            zip(answer.rewards, answer.similarities, answer.winners, strict=True)
        )
    ]
    show_table(("frame", "reward", "similarity", "fits best"), rows, last="wrapped")
    typer.echo(f"{len(rows)} frames, model {answer.model.name} {answer.model.version}")
    if answer.unknown:
        effect = "the similarity means little" if is_raw else "the goal is never rewarded"
        typer.echo(f"The model does not know {', '.join(answer.unknown)}: {effect}.")
    if answer.did_you_mean:
        typer.echo(f"Did you mean: {answer.did_you_mean}?")
    if answer.truncated:
        typer.echo("A text was too long for the model and was truncated.")


def _show_places(found: GroundResponse, path: Path, *, as_json: bool) -> None:
    unknown = [each.phrase for each in found.unknown_phrases]
    if as_json:
        places = [
            {"phrase": each.phrase, "x": each.x, "y": each.y, "presence": each.presence} for each in found.groundings
        ]
        print_json({"heatmap": str(path), "groundings": places, "unknown_phrases": unknown})
        return
    rows = [(each.phrase, f"{each.x:.1f}", f"{each.y:.1f}", f"{each.presence:.2f}") for each in found.groundings]
    show_table(("phrase", "x", "y", "presence"), rows)
    if unknown:
        typer.echo(f"The model does not know {', '.join(unknown)}: name things by colour, such as `a red block`.")
    typer.echo(f"Heatmaps: {path}")
