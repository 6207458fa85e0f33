"""Tables in `docs/` equal the code: configuration classes, and registries of what a configuration names.

A table stands below a comment that names its classes or its registry. `python tests/architecture/test_docs.py` rewrites
all tables, and what the command line says of the same configurations.
"""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from inspect import getattr_static
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import pytest
from pydantic import SecretStr
from pydantic_core import PydanticUndefined

from freerein.cli.jobs.config_keys import SCHEMAS
from freerein.serving.metrics import Metrics
from freerein_orchestrator.kinds.config_schemas import run_config_schema

ROOT = Path(__file__).parents[2]
TABLE = re.compile(r"(<!-- (?P<classes>[\w. ]+) -->\n\n)(?P<table>(\|.*\n)*)\n*")
TEXT_BELOW_TABLE = re.compile(r"^\|.*\n(?P<text>[^|\n].*)", re.MULTILINE)
TABLES = [
    pytest.param(page, *match.group("classes", "table"), id=match["classes"])
    for page in sorted((ROOT / "docs").glob("*.md"))
    for match in TABLE.finditer(page.read_text())
]
WORDS: dict[object, str] = {
    str: "text",
    bool: "true or false",
    Path: "a path",
    SecretStr: "text",
    dict[str, Any]: "an object",
    tuple[str, ...]: "a list of texts",
    tuple[float, ...]: "a list of numbers",
    tuple[dict[str, Any], ...]: "a list of objects",
}

_BOUNDS = ("gt", "ge", "le")


class Row(NamedTuple):
    """A row of a table."""

    key: str
    default: str
    may_be: str
    meaning: str


@pytest.mark.parametrize(("page", "classes", "table"), TABLES)
def test_a_table_says_what_its_classes_say(page: Path, classes: str, table: str) -> None:
    assert table == written(classes), f"{page} is stale: run python tests/architecture/test_docs.py"


def test_a_blank_line_follows_a_table() -> None:
    for page in (ROOT / "docs").glob("**/*.md"):
        glued = [match["text"] for match in TEXT_BELOW_TABLE.finditer(page.read_text())]
        assert not glued, f"without a blank line such a text of {page.name} is shown as a row"


def test_the_table_of_metrics_has_them_all() -> None:
    rows = re.findall(
        r"^\| `(freerein_\w+?)(?:_total)?` \| (\w+) \|", (ROOT / "docs/protocol.md").read_text(), re.MULTILINE
    )
    assert set(rows) == {(metric.name, metric.type) for metric in Metrics().registry.collect()}


def test_whatever_can_be_chosen_is_in_a_table() -> None:
    code = "\n".join(path.read_text() for folder in ("src", "services") for path in (ROOT / folder).rglob("*.py"))
    shown = {name.rpartition(".")[2] for each in TABLES for name in str(each.values[1]).split()}
    choices = {*re.findall(r"^class (\w+(?:Config|Settings))\b", code, re.MULTILINE)}
    assert choices - shown == {
        "ICMConfig",  # which runs choose themselves
        "GroundingConfig",  # which is chosen where models are made that come with freerein
    }


def test_the_command_line_knows_the_keys_of_every_configuration() -> None:
    assert json.loads(SCHEMAS.read_bytes()) == config_schemas(), "run python tests/architecture/test_docs.py"


def config_schemas() -> dict[str, list[Any]]:
    """Returns the JSON schemas of the configurations of fits by service, and of runs by kind."""
    modules = {service: f"freerein_{service}.methods" for service in ("segmentation", "imitation", "reward")}
    schemas = {service: import_module(module).METHODS.schema()["anyOf"] for service, module in modules.items()}
    for schema in run_config_schema()["anyOf"]:
        schemas.setdefault(schema["title"].split()[0], []).append(schema)
    return json.loads(json.dumps(schemas))


def written(classes: str) -> str:
    """Returns the table of a registry, or of classes, where a field of several classes appears once."""
    rows: dict[str, Row] = {}
    for name in classes.split():
        module, _, attribute = name.rpartition(".")
        kind = getattr(import_module(module), attribute)
        if isinstance(kind, Mapping):
            return registry_table(kind)
        for row in dataclass_rows(kind) if is_dataclass(kind) else settings_rows(kind):
            rows.setdefault(row.key, row)
    header = "| key | default | may be | meaning |\n|---|---|---|---|\n"
    return header + "".join(f"| {' | '.join(row)} |\n" for row in rows.values())


def registry_table(registry: Mapping[str, Any]) -> str:
    """Returns the table of what a configuration may name: functions or classes, by the first sentence of their docs."""
    sentences = {name: (inspect.getdoc(each) or "").partition("\n\n")[0] for name, each in registry.items()}
    rows = "".join(f"| `{name}` | {' '.join(text.split())} |\n" for name, text in sentences.items())
    return f"| name | what it is |\n|---|---|\n{rows}"


def dataclass_rows(kind: Any) -> Iterator[Row]:
    """Yields the rows of a dataclass without its bases."""
    types, meanings, declared = get_type_hints(kind), meanings_of(kind), {each.name: each for each in fields(kind)}
    for name in inspect.get_annotations(kind):
        value = declared[name].default
        if declared[name].default_factory is not MISSING:
            value = declared[name].default_factory()
        default = "needed" if value is MISSING else f"`{json.dumps(value)}`"
        bounds = getattr_static(kind, name, None)
        limits = (bounds._least, bounds._most) if hasattr(bounds, "_least") else ()
        names = ", ".join(f"`{each}`" for each in getattr(bounds, "_names", ()))
        yield Row(f"`{name}`", default, names or may_be(types[name], *limits), meanings[name])


def settings_rows(kind: Any) -> Iterator[Row]:
    """Yields the rows of a settings class without its bases."""
    meanings = meanings_of(kind)
    for name in inspect.get_annotations(kind):
        field = kind.model_fields[name]
        limits = [getattr(each, bound) for bound in _BOUNDS for each in field.metadata if hasattr(each, bound)]
        above = "above " if any(hasattr(each, "gt") for each in field.metadata) else ""
        default = "" if field.default in (None, PydanticUndefined) else f"`{field.default}`"
        yield Row(f"`FREEREIN_{name.upper()}`", default, above + may_be(field.annotation, *limits), meanings[name])


def may_be(kind: Any, *limits: float) -> str:
    """Returns the allowed values of a type within limits."""
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(may_be(each, *limits) for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is Literal:
        return ", ".join(f"`{each}`" for each in get_args(kind))
    if kind in (int, float):
        return " to ".join(f"{int(each):,}".replace(",", " ") if each == int(each) else str(each) for each in limits)
    return WORDS[kind]


def meanings_of(kind: type) -> dict[str, str]:
    """Returns the attribute docs of a class and its bases, by name."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, attributes = (inspect.getdoc(each) or "").partition("Attributes:\n")
        for name, text in re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", attributes, re.MULTILINE):
            found[name] = " ".join(text.split())
    return found


if __name__ == "__main__":
    for page in (ROOT / "docs").glob("*.md"):
        text = TABLE.sub(lambda match: f"{match[1]}{written(match['classes'])}\n", page.read_text())
        page.write_text(text.rstrip("\n") + "\n")
    lines = (f"{json.dumps(name)}: {json.dumps(schemas)}" for name, schemas in config_schemas().items())
    SCHEMAS.write_text("{\n" + ",\n".join(lines) + "\n}\n")
