"""Strict parsing of a configuration: a frozen dataclass says names, types, bounds, defaults; nothing else is taken."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from inspect import getattr_static
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from freerein.errors import InvalidInput

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_HUGE = 1e18
C = TypeVar("C", bound="DataclassInstance")
N = TypeVar("N", int, float)


def bounded(default: N, *, least: float, most: float) -> N:
    """Returns a dataclass field for a number in [least, most]: outside of them, none of that dataclass can be made."""
    return cast(N, _Bounded(default, least, most))


class _Bounded:
    """A descriptor-typed field, which a dataclass's `__init__` sets as any other."""

    def __init__(self, default: float, least: float, most: float) -> None:
        self._default = default
        self._least = least
        self._most = most

    def __set_name__(self, _owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object | None, _owner: type) -> float:
        if instance is None:  # a dataclass asks for the default
            return self._default
        value: float = vars(instance)[self._name]
        return value

    def __set__(self, instance: object, value: float) -> None:
        self.check(
            value, field=self._name, hint="What a dataset decides, such as the size of frames, is recorded anew."
        )
        vars(instance)[self._name] = value

    def check(self, value: float, *, field: str, hint: str) -> None:
        if not self._least <= value <= self._most:
            raise InvalidInput(
                f"`{self._name}` must be in [{self._least:g}, {self._most:g}]; got {value:g}.", field=field, hint=hint
            )


def parse(kind: type[C], values: Mapping[str, object]) -> C:
    """Returns the configuration that `values` describe; what is left out has its default.

    JSON and protobuf's Struct have one kind of number: 3.0 is taken where an int is wanted, 3.5 is not.

    Args:
        kind: A frozen dataclass whose fields are bool, int, float, str, tuple[str, ...] or Literal of strings.
        values: By field name.

    Raises:
        InvalidInput: A key is unknown, or missing where there is no default, or a value is of the wrong type or size.
    """
    types, names = get_type_hints(kind), [each.name for each in fields(kind)]
    for key in values:
        if key not in names:
            raise InvalidInput(
                f"The configuration may hold {', '.join(names)}; got another key.",
                field="config",
                hint=_suggestion(key, names),
            )
    missing = [each.name for each in fields(kind) if each.default is MISSING and each.name not in values]
    if missing:
        raise InvalidInput(f"The configuration must hold {', '.join(missing)}; got none.", field="config")
    parsed: dict[str, Any] = {key: _convert(key, types[key], value) for key, value in values.items()}
    for key, value in parsed.items():
        bounds = getattr_static(kind, key, None)
        if isinstance(bounds, _Bounded):
            bounds.check(value, field=f"config.{key}", hint="Leave it out for the default.")
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
