"""How verbs speak: tables and bars for people, one JSON document per line for programs, errors on stderr, exit code 1."""

import functools
import json
import sys
from collections.abc import Callable, Mapping
from typing import Annotated, ParamSpec

import typer
from rich.console import Console

from freerein.errors import ServiceError

P = ParamSpec("P")

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, one document per line.")]


def verb(run: Callable[P, None]) -> Callable[P, None]:
    """Decorates a verb: an error of ours is printed as a sentence and how to mend it, and the exit code is 1."""

    @functools.wraps(run)
    def reporting(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            run(*args, **kwargs)
        except ServiceError as error:
            print_error(error, as_json=bool(kwargs.get("as_json")))
            raise typer.Exit(1) from None

    return reporting


def print_json(document: Mapping[str, object]) -> None:
    """Prints a document on a line of its own, at once."""
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


def print_error(error: ServiceError, *, as_json: bool) -> None:
    """Prints an error on stderr."""
    if as_json:
        document = {"code": error.code, "detail": error.detail, "field": error.field, "hint": error.hint}
        sys.stderr.write(json.dumps({"error": document}) + "\n")
        return
    console = Console(stderr=True, highlight=False)
    console.print(f"[bold red]error:[/] {_escaped(error.detail)}", soft_wrap=True)
    if error.hint:
        console.print(f"[bold]hint:[/]  {_escaped(error.hint)}", soft_wrap=True)


def _escaped(text: str) -> str:
    from rich.markup import escape

    return escape(text)
