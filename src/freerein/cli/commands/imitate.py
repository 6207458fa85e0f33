"""`freerein imitate`: has a policy follow a demonstration, a folder of images, in a simulated task."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from freerein import images
from freerein.atomic_files import write_atomic
from freerein.cli.commands.image_files import read_images
from freerein.cli.connection import connect
from freerein.cli.imitation.follow import Demonstration, Followed, Landmark, follow
from freerein.cli.imitation.pictures import animation, filmstrip, fitted
from freerein.cli.output import AsJson, command, print_json, progress_bar
from freerein.clients import ImitationClient, SimClient
from freerein.errors import must_be
from freerein.types.common import Image, ModelRef
from freerein.types.imitation import Resize

app = typer.Typer(invoke_without_command=True, add_completion=False)

_DEMO = "[CAMERA=]DIR"
_FILMSTRIP, _ANIMATION = "imitation.png", "imitation.gif"


@app.callback()
@command
def imitate(
    *,
    task: Annotated[str, typer.Option("--task", "--world", help="Name of the task; see `freerein sim tasks`.")],
    demo: Annotated[list[str], typer.Option(metavar=_DEMO, help="Images in order of names; repeatable, by camera.")],
    model: Annotated[str, typer.Option(help="Name of the model; `default` when empty.")] = "",
    version: Annotated[str, typer.Option(help="Version of the model; the active one by default.")] = "",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    steps: Annotated[int, typer.Option(min=0, help="Most actions; 0: as many as an episode of the task has.")] = 0,
    steps_per_goal: Annotated[
        int, typer.Option(min=0, help="Actions until an image is abandoned; 0: the model's.")
    ] = 0,
    condition: Annotated[list[str] | None, typer.Option(help="Condition of the task; repeatable.")] = None,
    path: Annotated[str, typer.Option(help="Skill of the task whose demonstrations begin as the robot is to.")] = "",
    resize: Annotated[Resize | None, typer.Option(help="Make images of other sizes fit: whole, or the middle.")] = None,
    to: Annotated[Path, typer.Option(metavar="DIR", help="Folder for a filmstrip and an animation.")] = Path(),
    as_json: AsJson = False,
) -> None:
    """Have a policy follow a demonstration, a folder of images, in a simulated task."""
    goals = _in_order([read_images([each], is_series=True) for each in demo])
    reference = ModelRef(model, version)
    asked = Demonstration(task, goals, reference, seed, steps, steps_per_goal, tuple(condition or ()), path, resize)
    followed = asyncio.run(_follow(asked, as_json=as_json))
    camera, frame = next(iter(followed.seen[0].frames.items()))
    shown = [fitted(images.decode(goal), frame) for goal in goals if goal.camera in ("", camera)]
    to.mkdir(parents=True, exist_ok=True)
    write_atomic(to / _FILMSTRIP, filmstrip(followed, shown, camera))
    write_atomic(to / _ANIMATION, animation(followed, shown, camera))
    reached = sum(landmark.reached for landmark in followed.landmarks)
    if as_json:
        print_json({"landmarks": followed.total, "reached": reached, "actions": _actions(followed), "to": str(to)})
    else:
        typer.echo(
            f"{reached} of {followed.total} images reached, as the policy says, in {_actions(followed)} actions: "
            f"{followed.ending}. Pictures: {to / _FILMSTRIP}, {to / _ANIMATION}."
        )


async def _follow(asked: Demonstration, *, as_json: bool) -> Followed:
    """Returns how the demonstration was followed; says of each landmark when it is over."""
    followed, told = Followed(0), 0
    with progress_bar("following", total=len(asked.goals), is_shown=not as_json) as on_count:
        async with connect(SimClient, "sim") as sim, connect(ImitationClient, "imitation") as imitation:
            async for followed in follow(sim, imitation, asked):
                for landmark in followed.landmarks[told:]:
                    _tell(landmark, followed.total, as_json=as_json)
                told = len(followed.landmarks)
                on_count(told)
    return followed


def _tell(landmark: Landmark, total: int, *, as_json: bool) -> None:
    if as_json:
        print_json(vars(landmark))
        return
    mark, what = ("\N{CHECK MARK}", "reached") if landmark.reached else ("\N{MULTIPLICATION X}", "abandoned")
    typer.echo(
        f"{mark} image {landmark.index + 1} of {total} {what} at action {landmark.step}, "
        f"confidence {landmark.confidence:.2f}"
    )


def _actions(followed: Followed) -> int:
    return len(followed.seen) - 1


def _in_order(by_camera: list[tuple[Image, ...]]) -> tuple[Image, ...]:
    """Returns images of each camera for the first landmark, then for the next.

    Raises:
        InvalidInput: Folders have different numbers of images.
    """
    counts = [len(each) for each in by_camera]
    if len(set(counts)) > 1:
        raise must_be("Folders of images", "of one length", f"{counts} images", field="demo", hint="One per camera.")
    return tuple(image for landmark in zip(*by_camera, strict=True) for image in landmark)
