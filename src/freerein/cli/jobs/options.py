"""Options that the commands of fits and runs share, and the configuration that they make."""

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from freerein.cli.jobs.config_keys import text_keys
from freerein.errors import InvalidInput, must_be, quoted

Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the configuration, below; repeatable."),
]
FromStep = Annotated[int, typer.Option(min=0, max=10**12, help="First step to print.")]
MaxRows = Annotated[int, typer.Option(min=1, max=10_000, help="Maximum number of rows; more are decimated evenly.")]


def setting(text: str, texts: Collection[str] = ()) -> tuple[str, Any]:
    """Returns the key and value of a setting; the value is JSON, else a string, as that of a key in `texts` always is.

    So `dataset=20261105` names a dataset.
    """
    key, equals, value = text.partition("=")
    if not (key and equals):
        hint = "Write --set steps=200 or --set task=grid."
        raise must_be("A setting", "KEY=VALUE", quoted(text), field="set", hint=hint)
    try:
        parsed = json.loads(value)
    except json.JSONDecodeError:
        return key, value
    return key, parsed if key not in texts or isinstance(parsed, str) else value


def configuration(name: str, settings: Sequence[str] | None, file: Path | None = None) -> dict[str, Any]:
    """Returns the configuration of a service's fit or of a run, by kind, in a file, overridden by settings."""
    try:
        values = json.loads(file.read_bytes()) if file else {}
    except OSError as error:
        raise InvalidInput(
            f"A configuration file must be readable; {file} is not: {error.strerror}.",
            field="config",
            hint="Correct the path, or leave out --config and give the keys by --set KEY=VALUE.",
        ) from error
    except ValueError:
        values = None
    if not isinstance(values, dict):
        name, hint = "The contents of a configuration file", 'Such as {"task": "grid", "count": 20}.'
        raise must_be(name, "a JSON object", "something else", field="config", hint=hint)
    texts = text_keys(name)
    return {**values, **dict(setting(text, texts) for text in settings or ())}
