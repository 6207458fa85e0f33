"""Strict parsing of a configuration: a frozen dataclass says names, types, bounds, defaults; nothing else is taken."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, field, fields
from typing import TYPE_CHECKING, Literal, TypeVar, get_args, get_origin, get_type_hints

from freerein.errors import InvalidInput

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_HUGE = 1e18
C = TypeVar("C", bound="DataclassInstance")
N = TypeVar("N", int, float)


def bounded(default: N, *, least: float, most: float) -> N:
    """Returns a dataclass field for a number in [least, most]."""
    made: N = field(default=default, metadata={"least": least, "most": most})
    return made


def parse(kind: type[C], values: Mapping[str, object]) -> C:
    """Returns the configuration that `values` describe; what is left out has its default.

    JSON and protobuf's Struct have one kind of number: 3.0 is taken where an int is wanted, 3.5 is not.

    Args:
        kind: A frozen dataclass whose fields are bool, int, float, str, tuple[str, ...] or Literal of strings.
        values: By field name.

    Raises:
        InvalidInput: A key is unknown, or missing where there is no default, or a value is of the wrong type or size.
    """
    types, bounds = get_type_hints(kind), {each.name: each.metadata for each in fields(kind)}
    for key in values:
        if key not in bounds:
            raise InvalidInput(
                f"The configuration may hold {', '.join(bounds)}; got another key.",
                field="config",
                hint=_suggestion(key, bounds),
            )
    missing = [each.name for each in fields(kind) if each.default is MISSING and each.name not in values]
    if missing:
        raise InvalidInput(f"The configuration must hold {', '.join(missing)}; got none.", field="config")
    parsed = {key: _convert(key, types[key], value) for key, value in values.items()}
    for key, value in parsed.items():
        _check_bounds(key, value, bounds[key])
    return kind(**parsed)


def _suggestion(key: str, known: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(key[:64], list(known), n=1)
    return f"Did you mean `{nearest[0]}`?" if nearest else "Leave it out."


def _convert(key: str, kind: object, value: object) -> bool | int | float | str | tuple[str, ...]:
    if get_origin(kind) is Literal and isinstance(value, str) and value in get_args(kind):
        return value
    if kind in (bool, str) and type(value) is kind:
        return value
    if kind == tuple[str, ...] and isinstance(value, list | tuple) and all(isinstance(each, str) for each in value):
        return tuple(value)
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _HUGE:
        if kind is float:
            return float(value)
        if kind is int and value == int(value):
            return int(value)
    raise InvalidInput(f"`{key}` must be {_describe(kind)}; got something else.", field=f"config.{key}")


def _describe(kind: object) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(get_args(kind))
    names: dict[object, str] = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a string"}
    names[tuple[str, ...]] = "a list of strings"
    return names[kind]


def _check_bounds(key: str, value: object, bounds: Mapping[str, float]) -> None:
    if bounds and isinstance(value, int | float) and not bounds["least"] <= value <= bounds["most"]:
        raise InvalidInput(
            f"`{key}` must be in [{bounds['least']:g}, {bounds['most']:g}]; got {value:g}.",
            field=f"config.{key}",
            hint="Leave it out for the default.",
        )
