"""The configuration of a fit or run on the command line: `--config FILE.json` and `--set KEY=VALUE`."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from freerein.errors import InvalidInput

Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a configuration key; repeatable.")
]


def setting(text: str) -> tuple[str, Any]:
    """Returns the key and value of a setting; the value is JSON, else a string.

    Raises:
        InvalidInput: It has no key or no value.
    """
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise InvalidInput(
            "A setting must be KEY=VALUE; got one without a key or a value.",
            field="set",
            hint="Write --set steps=200 or --set task=grid.",
        )
    try:
        return key, json.loads(value)
    except json.JSONDecodeError:
        return key, value


def configuration(settings: Sequence[str] | None, file: Path | None = None) -> dict[str, Any]:
    """Returns the configuration in a file, overridden by settings.

    Raises:
        InvalidInput: The file does not hold a JSON object, or a setting is malformed.
    """
    return {**(_read(file) if file else {}), **dict(setting(text) for text in settings or ())}


def _read(file: Path) -> dict[str, Any]:
    try:
        values = json.loads(file.read_bytes())
    except ValueError:
        values = None
    if not isinstance(values, dict):
        raise InvalidInput(
            "A configuration file must hold a JSON object; this one holds something else.",
            field="config",
            hint='Such as {"task": "grid", "count": 20}.',
        )
    return values
