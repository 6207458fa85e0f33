"""`freerein dataset`: what a dataset holds, and whether it is whole and fit to learn from."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from freerein.cli.output import AsJson, print_json, show_table, verb

if TYPE_CHECKING:
    from freerein.data import DatasetSummary, Problem

app = typer.Typer(help="Datasets: what they hold, and whether they are whole.", no_args_is_help=True)

_GOAL_TEXTS = 6  # shown at most

_Name = Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")]


@app.command("list")
@verb
def list_datasets(as_json: AsJson = False) -> None:
    """List the datasets in the data directory."""
    from freerein.cli.settings import CliSettings

    names = sorted(path.parent.name for path in (CliSettings().data_dir / "datasets").glob("*/meta"))
    if as_json:
        print_json({"datasets": names})
    else:
        show_table(("dataset",), [(name,) for name in names])


@app.command()
@verb
def inspect(name: _Name, as_json: AsJson = False) -> None:
    """Say what a dataset holds."""
    from freerein import data

    summary = data.inspect(_root(name))
    if as_json:
        print_json({"dataset": name, **asdict(summary)})
    else:
        show_table(("", ""), _rows(name, summary))


@app.command()
@verb
def verify(name: _Name, as_json: AsJson = False) -> None:
    """Read every file of a dataset and name what is damaged; exit code 1 when anything is."""
    from freerein import data

    _report(name, data.verify, as_json=as_json, all_well="is whole")


@app.command()
@verb
def check(name: _Name, as_json: AsJson = False) -> None:
    """Name what keeps skills from being learnt from a dataset; exit code 1 when anything does."""
    from freerein import data

    _report(name, data.check, as_json=as_json, all_well="is fit for training")


def _report(name: str, examine: "Callable[[Path], list[Problem]]", *, as_json: bool, all_well: str) -> None:
    problems = examine(_root(name))
    if as_json:
        print_json({"dataset": name, "problems": [asdict(problem) for problem in problems]})
    elif problems:
        show_table(("where", "problem", "fix"), [(each.where, each.sentence, each.hint) for each in problems])
    else:
        typer.echo(f"The dataset {name} {all_well}.")
    if problems:
        raise typer.Exit(1)


def _root(name: str) -> Path:
    from freerein.cli.settings import CliSettings
    from freerein.data import dataset_path

    return dataset_path(CliSettings().data_dir, name)


def _goal_texts(summary: "DatasetSummary") -> str:
    """Returns the goal texts of trajectories, most frequent first, but for what the dataset says of all."""
    counts = sorted(summary.goal_text_counts.items(), key=lambda entry: -entry[1])
    own = [f"{text} ({count})" for text, count in counts if text != summary.spec.task]
    return "; ".join([*own[:_GOAL_TEXTS], *(["..."] if len(own) > _GOAL_TEXTS else [])]) or "none of their own"


def _rows(name: str, summary: "DatasetSummary") -> list[tuple[str, str]]:
    spec = summary.spec
    cameras = ", ".join(f"{camera} {'x'.join(map(str, size))}" for camera, size in spec.cameras.items())
    action = f"{spec.action.choices} choices" if spec.action.choices else f"{spec.action.size} numbers"
    return [
        ("dataset", name),
        ("task", spec.task),
        ("goal texts", _goal_texts(summary)),
        ("trajectories", f"{summary.trajectories}, of {summary.shortest} to {summary.longest} timesteps"),
        ("timesteps", f"{summary.frames}, {summary.duration_s / 60:.1f} minutes at {spec.fps} Hz"),
        ("cameras", cameras),
        ("action", action),
        ("skills", ", ".join(f"{skill} ({count})" for skill, count in summary.skill_counts.items()) or "none"),
        ("untagged", str(summary.untagged)),
        ("true labels", str(summary.labelled)),
        ("size", f"{summary.data_bytes / 1e6:.1f} MB"),
        ("fingerprint", summary.fingerprint),
    ]
