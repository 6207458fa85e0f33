"""Output of commands: progress bars, or JSON lines; errors on stderr with exit code 1."""

import functools
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, ParamSpec

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from freerein.cli.times import duration
from freerein.errors import FailedPrecondition, ServiceError, Unavailable

P = ParamSpec("P")

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, one document per line.")]


def command(run: Callable[P, None]) -> Callable[P, None]:
    """Decorates a command: prints a `ServiceError` or `OSError` with its hint and exits with code 1."""

    @functools.wraps(run)
    def reporting(*args: P.args, **kwargs: P.kwargs) -> None:
        as_json = bool(kwargs.get("as_json"))
        try:
            run(*args, **kwargs)
        except ServiceError as error:
            print_error(error, as_json=as_json)
            raise typer.Exit(1) from None
        except BrokenPipeError:
            raise  # the reader of a pipe is gone, as with `| head`
        except OSError as error:
            sentence = f"A file or port must be usable; got {error}."
            print_error(FailedPrecondition(sentence, hint="`freerein doctor` may say more."), as_json=as_json)
            raise typer.Exit(1) from None

    return reporting


def print_json(document: Mapping[str, object]) -> None:
    """Prints a document as one line, flushed."""
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


def print_error(error: ServiceError, *, as_json: bool) -> None:
    """Prints an error on stderr."""
    hint = f"{error.hint} `freerein up` runs the services.".lstrip() if type(error) is Unavailable else error.hint
    if as_json:
        document = {"code": error.code, "detail": error.detail, "field": error.field, "hint": hint}
        sys.stderr.write(json.dumps({"error": document}) + "\n")
        return
    console = Console(stderr=True)
    console.print(Text.assemble(("error: ", "bold red"), error.detail), soft_wrap=True)
    if hint:
        console.print(Text.assemble(("hint:  ", "bold"), hint), soft_wrap=True)


def delete_each(
    names: Sequence[str],
    delete: Callable[[str], object],
    *,
    noun: str,
    as_json: bool,
    shown: Callable[[str], str] = str,
) -> None:
    """Deletes one thing after another, and says so of each as `shown`; the first that is refused ends it."""
    for name in names:
        delete(name)
        print_json({noun: name, "deleted": True}) if as_json else typer.echo(f"Deleted {noun} {shown(name)}.")


@contextmanager
def progress_bar(name: str, *, total: int, is_shown: bool) -> Iterator[Callable[[int], None]]:
    """Yields a function that moves a progress bar on stderr; the bar is hidden where stderr is no terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _TimeLeft())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not (is_shown and console.is_terminal)) as progress:
        bar = progress.add_task(name, total=total)
        yield lambda done: progress.update(bar, completed=done)


class _TimeLeft(ProgressColumn):
    """The time that a task still takes."""

    def render(self, task: Task) -> Text:
        return Text("" if task.time_remaining is None else f"{duration(task.time_remaining)} left")
