"""`freerein dataset`: imports, inspects, checks, annotates and exports datasets."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from freerein import data
from freerein.atomic_files import write_atomic
from freerein.cli.dataset_words import summary_rows, takes
from freerein.cli.datasets import Replace, dataset_root, imported_with_progress, layout_of, replaceable_root
from freerein.cli.output import AsJson, command, delete_each, print_json
from freerein.cli.segments.webvtt import webvtt
from freerein.cli.settings import CliSettings
from freerein.cli.tables import show_table
from freerein.cli.times import ago
from freerein.data import (
    Dataset,
    FolderSource,
    LabelOptions,
    LeRobotOptions,
    LeRobotSource,
    MimeSource,
    Problem,
    Source,
    TextKind,
    TimeUnit,
    dataset_path,
)
from freerein.data.label_segments import read_label_segments, to_csv
from freerein.data.lerobot_export import export_labels
from freerein.data.lerobot_folder import export_lerobot
from freerein.data.lookup import dataset_names
from freerein.errors import InvalidInput, must_be, quoted
from freerein.jobs import wall_clock
from freerein.types.common import is_name

app = typer.Typer(
    help="Import, inspect, check, annotate and export datasets.", no_args_is_help=True, add_completion=False
)

_LARGEST_SIDE = 1024
_REPEATABLE = "repeatable; of layout lerobot."

_Texts = TextKind | None
_Features = list[str] | None
_Name = Annotated[str, typer.Argument(help="Name of a dataset in the data directory.")]


@app.command("list")
@command
def list_datasets(as_json: AsJson = False) -> None:
    """List the datasets in the data directory."""
    data_dir = CliSettings().data_dir
    found = {name: dataset_path(data_dir, name) / "meta" for name in dataset_names(data_dir)}
    if as_json:
        print_json({"datasets": list(found)})
    else:
        now_ns = wall_clock.now_ns()
        rows = [(name, ago(path.stat().st_mtime_ns, now_ns=now_ns)) for name, path in found.items()]
        show_table(("dataset", "changed"), rows)


@app.command("import")
@command
def import_dataset(
    path: Annotated[
        Path, typer.Argument(help="Folder of trajectories as images or mp4 files, of a LeRobotDataset v3, or of MIME.")
    ],
    name: Annotated[str, typer.Argument(help="Name of the new dataset in the data directory.")],
    *,
    size: Annotated[
        str,
        typer.Option(
            metavar="HxW",
            help="Scale frames, such as 96x128; their own size if empty. Rewards of relations need their proportions.",
        ),
    ] = "",
    layout: Annotated[
        Literal["auto", "folder", "lerobot", "mime"], typer.Option(help="What the folder holds; auto: by its `meta`.")
    ] = "auto",
    fps: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Timesteps per second, of layout folder; 10 by default.")
    ] = None,
    tags: Annotated[
        Path | None,
        typer.Option(metavar="TAGS.CSV", help="Skills by name of the trajectory, or by LeRobot's `episode_index`."),
    ] = None,
    action: Annotated[_Features, typer.Option(metavar="NAME", help=f"Feature of the action; {_REPEATABLE}")] = None,
    state: Annotated[_Features, typer.Option(metavar="NAME", help=f"Feature of the state; {_REPEATABLE}")] = None,
    cameras: Annotated[_Features, typer.Option(metavar="NAME", help=f"Camera to read; {_REPEATABLE}")] = None,
    tags_from: Annotated[_Texts, typer.Option(help="Take LeRobot's tasks or subtasks as tags.")] = None,
    labels_from: Annotated[_Texts, typer.Option(help="Take those of each timestep as true labels.")] = None,
    skip_damaged: Annotated[
        bool, typer.Option("--skip-damaged", help="Import what is whole of a LeRobotDataset, and count the rest.")
    ] = False,
    replace: Replace = False,
    as_json: AsJson = False,
) -> None:
    """Import trajectories of another tool: video is decoded once, actions stay in their own unit.

    Layout `folder`: `<trajectory>/0.png, 1.png, ...`, or `<trajectory>/<camera>/0.png, ...`, or `<trajectory>.mp4`.
    Beside them `<trajectory>/actions.csv`, where there are actions, and one `tags.csv`.
    """
    kind = layout if layout != "auto" else layout_of(path)
    options = LeRobotOptions(_names(action), _names(state), _names(cameras), skip_damaged)
    texts: dict[str, TextKind | None] = {"tags_from": tags_from, "labels_from": labels_from}
    source = _source(kind, path, size=_size(size), fps=fps, tags=tags, options=options, texts=texts)
    said = source.notes  # before video is decoded, which may take an hour
    if not as_json:
        typer.echo("".join(f"{note}\n" for note in said), nl=False)
    with imported_with_progress(source, name, replaces=replace, is_shown=not as_json) as warnings:
        pass  # what is shown undoes nothing
    _show_import(name, source, warnings, said=said, as_json=as_json)


def _source(
    kind: str,
    path: Path,
    *,
    size: tuple[int, int] | None,
    fps: int | None,
    tags: Path | None,
    options: LeRobotOptions,
    texts: Mapping[str, TextKind | None],
) -> Source:
    """Returns the trajectories of a folder of a layout; raises InvalidInput where an option is of another one."""
    table = tags.read_bytes() if tags else None
    if fps and kind != "folder":
        raise InvalidInput(
            f"--fps must be given with layout folder; the layout is {kind}, whose rate is its own.",
            field="fps",
            hint="Leave it out.",
        )
    if kind == "lerobot":
        return LeRobotSource(path, size=size, options=options, tags=table, **texts)
    if options != LeRobotOptions() or any(texts.values()) or (kind == "mime" and tags):
        raise InvalidInput(
            "--action, --state, --cameras, --tags-from, --labels-from and --skip-damaged must be given with layout "
            f"lerobot, and --tags not with mime; the layout is {kind}.",
            field="layout",
            hint="Leave them out, or name the folder that holds `meta`.",
        )
    rate = {"fps": fps} if fps else {}
    return FolderSource(path, size=size, tags=table, **rate) if kind == "folder" else MimeSource(path, size=size)


def _names(given: list[str] | None) -> tuple[str, ...]:
    """Returns the names of a repeatable option; one may hold several, separated by commas."""
    return tuple(name.strip() for each in given or () for name in each.split(","))


def _size(text: str) -> tuple[int, int] | None:
    height, _, width = text.partition("x")
    if not text:
        return None
    if not all(each.isascii() and each.isdigit() and 0 < int(each) <= _LARGEST_SIDE for each in (height, width)):
        rule = f"height x width, each from 1 to {_LARGEST_SIDE} pixels"
        raise must_be("The size", rule, quoted(text), field="size", hint="For example: --size 96x128.")
    return int(height), int(width)


@app.command()
@command
def inspect(name: _Name, as_json: AsJson = False) -> None:
    """Show the contents of a dataset."""
    summary = data.inspect(dataset_root(name))
    if as_json:
        print_json({"dataset": name, **asdict(summary)})
    else:
        show_table(("", ""), summary_rows(name, summary), last="wrapped")


@app.command()
@command
def verify(
    name: Annotated[str, typer.Argument(help="Name of a dataset in the data directory, or a folder.")],
    as_json: AsJson = False,
) -> None:
    """Read every file of a dataset and list damage; exit code 1 where there is any."""
    folder = Path(name).expanduser()
    is_folder = "/" in name or (folder.is_dir() and not (is_name(name) and dataset_root(name).is_dir()))
    root = folder if is_folder else dataset_root(name)
    _report(name, data.verify(root), as_json=as_json, verdict="is undamaged")


@app.command()
@command
def check(name: _Name, as_json: AsJson = False) -> None:
    """List what prevents learning skills from a dataset, and warnings; exit code 1 where a fit would refuse it.

    Where there are no errors it says what `freerein fit segmentation NAME` takes: an estimate of its minutes on a CPU,
    and the most memory.
    """
    root = dataset_root(name)
    problems = data.check(root)
    is_fit = all(problem.severity != "error" for problem in problems)
    predicted = data.predict_fit(root) if is_fit else None
    fit = {"fit": asdict(predicted)} if predicted else {}
    _report(name, problems, as_json=as_json, verdict="is fit for training", more=fit)
    if predicted and not as_json:
        typer.echo(f"freerein fit segmentation {name} {takes(predicted)}")


@app.command()
@command
def tag(
    name: _Name,
    table: Annotated[Path, typer.Argument(metavar="TAGS.CSV", help="Columns `trajectory` and `skills`.")],
    as_json: AsJson = False,
) -> None:
    """Tag trajectories with the skills that occur in them: lines such as `0,reach;pour` below `trajectory,skills`.

    All lines are valid, or nothing changes; trajectories that are not listed keep their tags.
    """
    notes = list[str]()
    count = data.tag(dataset_root(name), table.read_bytes(), on_note=notes.append)
    _show_count(name, "tagged", count, notes, as_json=as_json)


@app.command()
@command
def label(
    name: _Name,
    table: Annotated[Path, typer.Argument(metavar="LABELS.CSV", help="Columns `trajectory`, `start`, `end`, `skill`.")],
    *,
    trajectory: Annotated[
        int | None, typer.Option(min=0, help="Index of the trajectory that a table without a column of it is about.")
    ] = None,
    unit: Annotated[
        TimeUnit | None,
        typer.Option(
            metavar="UNIT",
            help="Of times: timesteps, seconds or milliseconds; by default as the columns' names say, else seconds "
            "where one has a point.",
        ),
    ] = None,
    tier: Annotated[str, typer.Option(help="Tier to read of several in an export of ELAN.")] = "",
    with_tags: Annotated[
        bool, typer.Option("--tags", help="Tag the trajectories with the skills of their labels.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Store true labels of a few trajectories, to measure frame accuracy; no fit sees them.

    Lines such as `0,0,41,reach` below `trajectory,start,end,skill` are segments [start, end), in timesteps or seconds;
    lines below `trajectory,timestep,skill` label one each. Exports of ELAN, separated by tabs, are read, too. Timesteps
    that are not listed have no label.
    """
    notes, options = list[str](), LabelOptions(trajectory, unit, tier)
    text = table.read_bytes()
    count = data.label(dataset_root(name), text, options=options, with_tags=with_tags, on_note=notes.append)
    _show_count(name, "labelled", count, notes, as_json=as_json)


@app.command()
@command
def rm(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Names of datasets in the data directory.")],
    as_json: AsJson = False,
) -> None:
    """Delete datasets; one that a fit or run reads, or a process writes, stays and the error says so."""
    roots = [replaceable_root(name) for name in names]
    delete_each(names, lambda name: data.delete(roots[names.index(name)]), noun="dataset", as_json=as_json)


@app.command()
@command
def prune(as_json: AsJson = False) -> None:
    """Delete the decoded frames of all datasets, which take much room; the next fit decodes them again."""
    freed = data.prune(CliSettings().data_dir / "datasets")
    print_json({"freed_bytes": freed}) if as_json else typer.echo(f"{freed / 1e6:.1f} MB are free again.")


@app.command()
@command
def export(
    name: _Name,
    *,
    to: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write the dataset, a LeRobotDataset v3, to this folder, new or empty."),
    ] = None,
    lerobot: Annotated[
        Path | None,
        typer.Option(metavar="ORIGINAL", help="Write into the LeRobotDataset v3 that it was imported from."),
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Write a table, `trajectory,start,end,skill`, to this file.")] = None,
    vtt: Annotated[
        Path | None, typer.Option(help="Write subtitles, WebVTT, of each trajectory to this folder.")
    ] = None,
    replace: Annotated[
        bool, typer.Option("--replace", help="Replace other subtasks that the LeRobotDataset has.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Write a dataset, or the labels of `freerein segment NAME --save`, where other programs read them.

    With --to it is the dataset: frames, actions, goal texts. The other forms are its labels: in a LeRobotDataset they
    become rows of style `subtask` in `language_persistent`, and the stages that SARM reads; its images, actions and all
    else stay as they are.
    """
    written = {form: path for form, path in (("lerobot", lerobot), ("csv", csv), ("vtt", vtt)) if path}
    if not written and not to:
        hint = "Write --to DIR for the dataset, or --lerobot ORIGINAL, --csv FILE or --vtt FOLDER for its labels."
        raise must_be("A form", "chosen", "none", field="lerobot", hint=hint)
    root = dataset_root(name)
    if to is not None:
        count = export_lerobot(root, to)
        if as_json:
            print_json({"dataset": name, "to": str(to), "trajectories": count})
        else:
            typer.echo(f"{count} trajectories of {name} are in {to}, which LeRobot opens.")
    if written:
        _export_labels(name, root, written, replaces=replace, as_json=as_json)


def _export_labels(name: str, root: Path, written: Mapping[str, Path], *, replaces: bool, as_json: bool) -> None:
    dataset = Dataset(root)
    segments, fps = read_label_segments(root, dataset), dataset.spec.fps
    if "lerobot" in written:
        export_labels(root, written["lerobot"], replaces=replaces)
    if "csv" in written:
        write_atomic(written["csv"], to_csv(segments).encode())
    if "vtt" in written:
        for index, some in enumerate(segments):
            cues = ((each.start / fps, each.end / fps, each.skill) for each in some if each.skill)
            write_atomic(written["vtt"] / f"trajectory-{index:03}.vtt", webvtt(cues).encode())
    if as_json:
        print_json({"dataset": name, **{form: str(path) for form, path in written.items()}})
    else:
        typer.echo("\n".join(f"The labels of {name} are in {path}." for path in written.values()))


def _show_import(name: str, source: Source, warnings: Sequence[str], *, said: Collection[str], as_json: bool) -> None:
    count = len(Dataset(dataset_root(name)))
    notes = [*source.notes, *warnings]
    if as_json:
        print_json({"dataset": name, "imported": count, "contents": source.contents, "notes": notes})
        return
    contents = f": {source.contents}" if source.contents else ""
    new = [note for note in notes if note not in said]
    typer.echo("\n".join([f"{count} trajectories of {name} are imported{contents}.", *new]))


def _show_count(name: str, done: str, count: int, notes: Sequence[str], *, as_json: bool) -> None:
    if as_json:
        print_json({"dataset": name, done: count, "notes": notes})
    else:
        typer.echo("\n".join([f"{count} trajectories of {name} are {done}.", *notes]))


def _report(
    name: str, problems: Sequence[Problem], *, as_json: bool, verdict: str, more: Mapping[str, object] = {}
) -> None:
    errors = sum(problem.severity == "error" for problem in problems)
    if as_json:
        print_json({"dataset": name, "problems": [asdict(problem) for problem in problems], **more})
    elif problems:
        rows = [(each.severity, each.where, f"{each.sentence} {each.hint}".rstrip()) for each in problems]
        show_table(("", "where", "problem and fix"), rows, last="wrapped")
    if not as_json and not errors:
        typer.echo(f"The dataset {name} {verdict}{', with warnings' if problems else ''}.")
    if errors:
        raise typer.Exit(1)
