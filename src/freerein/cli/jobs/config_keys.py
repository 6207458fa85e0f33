"""The keys of `--set` in the help of the commands that take it: default, meaning and bounds.

`config_schemas.json` has the JSON schemas of the configurations, as the services serve them: by service for fits, by
kind for runs, one for each method or form. `python tests/architecture/test_docs.py` writes it.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from rich.console import Console
from rich.text import Text
from typer.core import TyperCommand

from freerein.cli.tables import table_lines

Schema: TypeAlias = Mapping[str, Any]

SCHEMAS = Path(__file__).parent / "config_schemas.json"
_GIVEN = "freerein.words"
_NEEDED = "needed"


class KeysHelp(TyperCommand):
    """A command whose help ends with the keys of `--set`: of the kind that is given with it, or of all."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Remembers the words of the command line for the help, which ends it while they are parsed."""
        ctx.meta[_GIVEN] = (self.name, *args)
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Prints the help, then the keys."""
        super().format_help(ctx, formatter)
        console = Console(soft_wrap=True, highlight=False)
        for line in help_lines(ctx.meta[_GIVEN], width=console.width):
            console.print(Text(line))


def help_lines(given: Sequence[str], *, width: int) -> Iterator[str]:
    """Yields the keys of the service or kind among some words; of all kinds of runs where there is none."""
    schemas: Mapping[str, list[Schema]] = json.loads(SCHEMAS.read_bytes())
    named = [name for name in schemas if name in given]
    for name in named or [name for name in schemas if not _is_of_fits(schemas[name])]:
        yield from _lines(name, schemas[name], width=width)


def text_keys(name: str) -> frozenset[str]:
    """Returns the keys of a service's fits, or of a kind of runs, that are strings wherever they occur."""
    schemas: Sequence[Schema] = json.loads(SCHEMAS.read_bytes()).get(name, ())
    found = [(key, value.get("type")) for schema in schemas for key, value in schema["properties"].items()]
    return frozenset(key for key, kind in found if kind == "string") - {key for key, kind in found if kind != "string"}


def _is_of_fits(schemas: Sequence[Schema]) -> bool:
    return "method" in schemas[0]["properties"]


def _lines(name: str, schemas: Sequence[Schema], *, width: int) -> Iterator[str]:
    """Yields the keys that all methods or forms share, then those of each."""
    first, *others = schemas
    shared = {
        key: value
        for key, value in first["properties"].items()
        if all(each["properties"].get(key) == value for each in others)
    }
    yield f" Keys of --set, {name}:"
    yield from _table(shared, first["required"], width=width)
    for schema in schemas if others else ():
        choice = "method" if _is_of_fits(schemas) else "form"
        own = {key: value for key, value in schema["properties"].items() if key not in {*shared, choice}}
        default = ", the default" if schema is first else ""
        yield f" With {choice}={schema['title'].split()[-1]}{default}, also:"
        yield from _table(own, schema["required"], width=width)


def _table(properties: Mapping[str, Schema], needed: Sequence[str], *, width: int) -> Iterator[str]:
    rows = [
        (
            f"   {key}",
            _NEEDED if key in needed else json.dumps(value.get("default")),
            f"{value['description']} {_bounds(value)}".rstrip(),
        )
        for key, value in properties.items()
        if "const" not in value
    ]
    yield from table_lines([("   key", "default", "meaning"), *rows], width=width, last="wrapped")
    yield ""


def _bounds(value: Schema) -> str:
    """Returns what a value may be, where that is more than its type."""
    if "enum" in value:
        return f"One of {', '.join(map(str, value['enum']))}."
    if "minimum" in value:
        return f"{value['minimum']:.15g} to {value['maximum']:.15g}."
    return ""
