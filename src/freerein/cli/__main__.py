"""`freerein`: the command line."""

from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from freerein import __version__

COMMANDS = {
    "up": "Run the services until Ctrl-C; restart them when they crash.",
    "doctor": "Check this machine and the services; exit code 1 where something required is missing.",
    "demo": "Show what freerein does, in three to five minutes: four results of its models, then two that are learned.",
    "segment": "Label every timestep of a video or a trajectory with a skill; with --save, of a whole dataset.",
    "reward": "Reward images against a goal text.",
    "act": "Ask a policy for the next actions towards goal images, a recipe of skills, or a goal text.",
    "imitate": "Have a policy follow a demonstration, a folder of images, in a simulated task.",
    "sim": "List simulated tasks and record demonstrations.",
    "fit": "Start a fit of a model.",
    "run": "Start a run, which survives crashes: collect, fit, label, ppo, distill, evaluate, pipeline, skills, zsrm.",
    "jobs": "Fits and runs: list, watch, resume and delete them.",
    "dataset": "Import, inspect, check, annotate and export datasets.",
    "models": "Models of the segmentation, imitation and reward services.",
}
"""The first paragraph of each command's help."""


_FIT_VERBS = ("list", "watch", "metrics", "cancel", "rm", "resume")


class _LazyGroup(TyperGroup):
    """Imports the module of a command, with its `app`, only when the command runs: `freerein --help` is fast."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, placeholder, rest = super().resolve_command(ctx, present_words(args))
        if name is None or placeholder is None:
            return name, placeholder, rest
        package = "freerein.cli" if name in ("doctor", "demo") else "freerein.cli.commands"
        return name, typer.main.get_command(import_module(f"{package}.{name}").app), rest


def present_words(args: list[str]) -> list[str]:
    """Returns a command line with `run` and `jobs` in place of what `runs` and `fit` did before there were these."""
    match args:
        case ["runs", "start", *rest]:
            return ["run", *rest]
        case ["runs", str(verb), *rest] if verb not in ("artifacts", "--help"):
            return ["jobs", verb, "--service", "orchestrator", *rest]
        case ["runs", *rest]:
            return ["jobs", *rest]
        case ["fit", "report", *rest]:
            return ["jobs", "report", *rest]
        case ["fit", str(verb), *rest] if verb in _FIT_VERBS:
            return ["jobs", verb, "--service", "fits", *rest]
    return args


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(f"freerein {__version__}")
        raise typer.Exit


app = typer.Typer(
    cls=_LazyGroup,
    help="Serve learned robot skills. `freerein demo` shows everything; `freerein doctor` checks the machine.",
    epilog="Exit codes: 0 success, 1 error, 2 invalid command line, 130 Ctrl-C. Of `up`: 0 Ctrl-C, 3 where starting it "
    "again cannot help.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def _options(
    version: Annotated[  # its callback answers
        bool, typer.Option("--version", help="Show the version and exit.", callback=_say_version, is_eager=True)
    ] = False,
) -> None: ...


for _name, _help in COMMANDS.items():
    app.command(_name, help=_help)(lambda: None)


def main() -> None:
    """Runs the command line."""
    app(prog_name="freerein")


if __name__ == "__main__":
    main()
