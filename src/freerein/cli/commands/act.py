"""`freerein act`: asks a policy for the next actions, or for its observation and action spec."""

from typing import Annotated

import numpy as np
import numpy.typing as npt
import typer

from freerein import wire
from freerein.cli.commands.image_files import FILES, read_images
from freerein.cli.connection import call
from freerein.cli.output import AsJson, command, print_json
from freerein.cli.tables import show_table
from freerein.clients import ImitationClient
from freerein.errors import must_be, quoted
from freerein.types.common import Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse, Resize

app = typer.Typer(invoke_without_command=True, add_completion=False)

Model = Annotated[str, typer.Option(help="Name of the model; `default` when empty.")]
Version = Annotated[str, typer.Option(help="Version of the model; the active one by default.")]
_Images = Annotated[list[str] | None, typer.Option(metavar=FILES, help="Current image; repeatable, one per camera.")]
_Goals = Annotated[list[str] | None, typer.Option(metavar=FILES, help="Goal image; repeatable, in order.")]
_Recipe = Annotated[list[str] | None, typer.Option(metavar="SKILL", help="Skill to execute; repeatable, in order.")]
_RobotState = Annotated[str, typer.Option(metavar="N,N,...", help="The robot's own state, for models that take it.")]
_Resize = Annotated[Resize | None, typer.Option(help="Make images of other sizes fit: whole, or the middle.")]
_GoalText = Annotated[str, typer.Option(metavar="TEXT", help="Goal text.")]


@app.callback()
@command
def act(
    context: typer.Context,
    *,
    image: _Images = None,
    goal: _Goals = None,
    recipe: _Recipe = None,
    goal_text: _GoalText = "",
    robot_state: _RobotState = "",
    resize: _Resize = None,
    model: Model = "",
    version: Version = "",
    as_json: AsJson = False,
) -> None:
    """Ask a policy for the next actions towards goal images, a recipe of skills, or a goal text."""
    if context.invoked_subcommand:
        return

    _check(image, goal, recipe, goal_text)
    request = ActRequest(
        observation=Observation(read_images(image or ()), _numbers(robot_state) if robot_state else None),
        goal=Goal(read_images(goal or (), is_series=True), tuple(recipe or ()), goal_text),
        model=ModelRef(model, version),
        resize=resize,
    )
    answer = call(ImitationClient, "imitation", lambda client: client.act(request))
    print_json(wire.to_json(answer)) if as_json else _show_answer(answer)


@app.command()
@command
def spec(model: Model = "", version: Version = "", as_json: AsJson = False) -> None:
    """Show the observations and actions of a model."""
    request = GetSpecRequest(ModelRef(model, version))
    answer = call(ImitationClient, "imitation", lambda client: client.get_spec(request))
    print_json(wire.to_json(answer)) if as_json else _show_spec(answer)


def _check(image: list[str] | None, goal: list[str] | None, recipe: list[str] | None, goal_text: str) -> None:
    if not image:
        raise must_be("The current image", "given", "none", field="image", hint="Send --image now.png.")
    given = sum(map(bool, (goal, recipe, goal_text)))
    if given != 1:
        name, hint = "Exactly one of goal images, a recipe and a goal text", "`freerein act spec` shows the goal form."
        raise must_be(name, "given", f"{given or 'none'} of them", field="goal", hint=hint)


def _numbers(text: str) -> npt.NDArray[np.float32]:
    try:
        return np.array([float(number) for number in text.split(",")], np.float32)
    except ValueError:
        name, hint = "The robot's state", "Send --robot-state=-0.5,12.3 with as many as `freerein act spec` tells."
        raise must_be(name, "numbers separated by commas", quoted(text), field="robot_state", hint=hint) from None


def _show_answer(answer: ActResponse) -> None:
    rows = [(str(step), ", ".join(f"{number:.4g}" for number in action)) for step, action in enumerate(answer.actions)]
    show_table(("step", "action"), rows, last="wrapped")
    if answer.done == "yes":
        reached = "done: reached" if answer.done_by == "policy" else "done: the step limit ended it"
    else:
        reached = f"pursuing goal {answer.goal_index}"
    abandoned = ", one abandoned" if answer.goal_abandoned else ""
    is_unknown = answer.goal_reached is None
    confidence = "the model does not recognize goals" if is_unknown else f"confidence {answer.goal_confidence:.2f}"
    typer.echo(f"{reached}{abandoned}; {confidence}; {_name(answer.model)}")


def _show_spec(answer: GetSpecResponse) -> None:
    cameras = ", ".join(f"{camera.name} {camera.height}x{camera.width}" for camera in answer.cameras)
    action = answer.action
    rows = [
        ("cameras", cameras),
        ("action", f"{action.choices} choices" if action.choices else f"{action.size} numbers in [-1, 1]"),
        ("names", ", ".join(action.names)),
        ("horizon", f"{answer.horizon} actions, one every {answer.control_dt_s:g} s"),
        ("goal", answer.goal_form),
        ("skills", ", ".join(answer.skills)),
        ("robot state", f"{answer.robot_state_size} numbers" if answer.robot_state_size else ""),
        ("max steps per goal", str(answer.max_steps_per_goal)),
        ("reached threshold", f"{answer.reached_threshold:.2f}" if answer.reached_threshold < 1 else ""),
        ("model", _name(answer.model)),
    ]
    show_table(("", ""), [row for row in rows if row[1]], last="wrapped")


def _name(model: ModelRef) -> str:
    return f"model {model.name} {model.version}"
