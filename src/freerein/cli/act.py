"""`freerein act`: what a policy would do next, and what it wants to see."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from freerein.cli.image_files import FILES, read_images
from freerein.cli.output import AsJson, print_json, show_table, verb
from freerein.errors import InvalidInput

if TYPE_CHECKING:
    from freerein.clients import ImitationClient
    from freerein.types.common import ModelRef
    from freerein.types.imitation import ActResponse, GetSpecResponse

T = TypeVar("T")

app = typer.Typer(invoke_without_command=True)

Model = Annotated[str, typer.Option(help="Name of the model; `default` when empty.")]
Version = Annotated[str, typer.Option(help="Version of the model; the active one when empty.")]
_Images = Annotated[list[str] | None, typer.Option(metavar=FILES, help="What is seen now; one per camera.")]
_Goals = Annotated[
    list[str] | None, typer.Option(metavar=FILES, help="An image to reach; several, one after the other.")
]
_Recipe = Annotated[
    list[str] | None, typer.Option(metavar="SKILL", help="A skill to execute; several, one after the other.")
]


@app.callback()
@verb
def act(
    context: typer.Context,
    *,
    image: _Images = None,
    goal: _Goals = None,
    recipe: _Recipe = None,
    model: Model = "",
    version: Version = "",
    as_json: AsJson = False,
) -> None:
    """Ask a policy once for the next actions towards goal images, or through a recipe of skills."""
    if context.invoked_subcommand:
        return
    from freerein import wire
    from freerein.types.common import Goal, ModelRef, Observation
    from freerein.types.imitation import ActRequest

    _check(image, goal, recipe)
    request = ActRequest(
        observation=Observation(read_images(image or ())),
        goal=Goal(read_images(goal or ()), tuple(recipe or ())),
        model=ModelRef(model, version),
    )
    answer = asyncio.run(_call(lambda client: client.act(request)))
    print_json(wire.to_json(answer)) if as_json else _show_answer(answer)


@app.command()
@verb
def spec(model: Model = "", version: Version = "", as_json: AsJson = False) -> None:
    """Say what a model wants to see and what its actions mean."""
    from freerein import wire
    from freerein.types.common import ModelRef
    from freerein.types.imitation import GetSpecRequest

    request = GetSpecRequest(ModelRef(model, version))
    answer = asyncio.run(_call(lambda client: client.get_spec(request)))
    print_json(wire.to_json(answer)) if as_json else _show_spec(answer)


async def _call(ask: "Callable[[ImitationClient], Awaitable[T]]") -> T:
    from freerein.cli.connection import open_channel
    from freerein.cli.settings import CliSettings
    from freerein.clients import ImitationClient

    async with ImitationClient(open_channel("imitation", CliSettings())) as client:
        return await ask(client)


def _check(image: list[str] | None, goal: list[str] | None, recipe: list[str] | None) -> None:
    if not image:
        raise InvalidInput(
            "An image of what is seen now must be given; got none.", field="image", hint="Send --image now.png."
        )
    if bool(goal) == bool(recipe):
        raise InvalidInput(
            f"Exactly one of goal images and a recipe must be given; got {'both' if goal else 'neither'}.",
            field="goal",
            hint="`freerein act spec` says which one the model takes.",
        )


def _show_answer(answer: "ActResponse") -> None:
    rows = [(str(step), ", ".join(f"{number:.4g}" for number in action)) for step, action in enumerate(answer.actions)]
    show_table(("step", "action"), rows)
    reached = "reached" if answer.goal_reached else f"pursuing goal {answer.goal_index}"
    abandoned = ", one was given up" if answer.goal_abandoned else ""
    typer.echo(f"{reached}{abandoned}; confidence {answer.goal_confidence:.2f}; {_name(answer.model)}")


def _show_spec(answer: "GetSpecResponse") -> None:
    cameras = ", ".join(f"{camera.name} {camera.height}x{camera.width}" for camera in answer.cameras)
    action = answer.action
    rows = [
        ("cameras", cameras),
        ("action", f"{action.choices} choices" if action.choices else f"{action.size} numbers in [-1, 1]"),
        ("names", ", ".join(action.names)),
        ("horizon", f"{answer.horizon} actions, one every {answer.control_dt_s:g} s"),
        ("goal", answer.goal_form),
        ("skills", ", ".join(answer.skills)),
        ("gives up after", f"{answer.max_steps_per_goal} steps"),
        ("reached from", f"confidence {answer.reached_threshold:.2f}"),
        ("model", _name(answer.model)),
    ]
    show_table(("", ""), [row for row in rows if row[1]])


def _name(model: "ModelRef") -> str:
    return f"model {model.name} {model.version}"
