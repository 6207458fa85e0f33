"""Strict parsing of configurations: a frozen dataclass declares names, types, bounds and defaults."""

import difflib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from inspect import getattr_static
from types import UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from freerein.errors import InvalidInput, quoted

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_HUGE = 1e18
_UNIONS = (Union, UnionType)
C = TypeVar("C", bound="DataclassInstance")
N = TypeVar("N", int, float)


def bounded(default: N, *, least: float, most: float) -> N:
    """Returns a dataclass field for a number in [least, most], checked whenever an instance is constructed."""
    return cast(N, _Bounded(default, least, most))


def bounded_or_all(default: int | Literal["all"], *, least: int, most: int) -> int | Literal["all"]:
    """Returns a dataclass field for a whole number as in `bounded`, or the word `all`."""
    return cast(int | Literal["all"], _BoundedOr("all", default, least, most))


def bounded_or_none(default: float | None, *, least: float, most: float) -> float | None:
    """Returns a dataclass field for a number as in `bounded`, or None."""
    return cast(float | None, _BoundedOr(None, default, least, most))


def one_of(names: Collection[str], default: str) -> str:
    """Returns a dataclass field for one of some names, such as a registry's keys; checked as `bounded`."""
    return cast(str, _OneOf(default, names))


class _Checked(ABC):
    """A descriptor-typed dataclass field whose value is checked."""

    def __init__(self, default: Any) -> None:
        self._default = default

    def __set_name__(self, _owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: object | None, _owner: type) -> Any:
        return self._default if instance is None else vars(instance)[self._name]  # a dataclass asks for the default

    def __set__(self, instance: object, value: Any) -> None:
        self.check(
            value, field=self._name, hint="Values that a dataset decides, such as the frame size, need another dataset."
        )
        vars(instance)[self._name] = value

    @abstractmethod
    def check(self, value: Any, *, field: str, hint: str) -> None:
        """Raises InvalidInput where a value is not allowed."""

    @abstractmethod
    def limits(self) -> dict[str, Any]:
        """Returns what is allowed, in the keywords of JSON schema."""


class _OneOf(_Checked):
    def __init__(self, default: str, names: Collection[str]) -> None:
        super().__init__(default)
        self._names = names

    def limits(self) -> dict[str, Any]:
        return {"enum": list(self._names)}

    def check(self, value: Any, *, field: str, hint: str) -> None:
        if value not in self._names:
            raise InvalidInput(
                f"`{self._name}` must be one of {', '.join(self._names)}; got {quoted(str(value))}.",
                field=field,
                hint=hint,
            )


class _Bounded(_Checked):
    def __init__(self, default: float | str | None, least: float, most: float) -> None:
        super().__init__(default)
        self._least = least
        self._most = most

    def limits(self) -> dict[str, Any]:
        return {"minimum": self._least, "maximum": self._most}

    def check(self, value: Any, *, field: str, hint: str) -> None:
        if not self._least <= value <= self._most:
            raise InvalidInput(
                f"`{self._name}` must be in [{self._least:g}, {self._most:g}]; got {value:g}.", field=field, hint=hint
            )


class _BoundedOr(_Bounded):
    def __init__(self, other: str | None, default: float | str | None, least: float, most: float) -> None:
        super().__init__(default, least, most)
        self._other = other

    def check(self, value: Any, *, field: str, hint: str) -> None:
        if value != self._other:
            super().check(value, field=field, hint=hint)


def parse(kind: type[C], values: Mapping[str, object]) -> C:
    """Returns the configuration of the given values; other fields take their defaults.

    JSON and protobuf's Struct have one number type: for an int, 3.0 is accepted and 3.5 is not. A single value stands
    for a list of one.

    Args:
        kind: A frozen dataclass whose fields are bool, int, float, str, Literal of strings, dict[str, Any], frozen
            dataclasses, tuples of any length of one of these, or unions of these.
        values: Values by field name.

    Raises:
        InvalidInput: A key is unknown or missing, or a value has the wrong type or is out of bounds.
    """
    types, names = get_type_hints(kind), [each.name for each in fields(kind)]
    for key in values:
        if key not in names:
            raise InvalidInput(
                f"The configuration may hold {', '.join(names)}; got an unknown key.",
                field="config",
                hint=_suggestion(key, names),
            )
    needed = [each.name for each in fields(kind) if each.default is MISSING and each.default_factory is MISSING]
    missing = [name for name in needed if name not in values]
    if missing:
        raise InvalidInput(
            f"The configuration must hold {', '.join(missing)}; got none.", field="config", hint="Add the missing keys."
        )
    parsed: dict[str, Any] = {key: _convert(key, types[key], value) for key, value in values.items()}
    for key, value in parsed.items():
        bounds = getattr_static(kind, key, None)
        if isinstance(bounds, _Checked):
            bounds.check(value, field=f"config.{key}", hint="Leave it out for the default.")
    return kind(**parsed)


def _suggestion(key: str, known: Iterable[str]) -> str:
    nearest = difflib.get_close_matches(key[:64], list(known), n=1)
    return f"Did you mean `{nearest[0]}`?" if nearest else "Leave it out."


def _convert(key: str, kind: object, value: object) -> Any:
    for each in get_args(kind) if get_origin(kind) in _UNIONS else (kind,):
        converted = _converted(each, value)
        if converted is not MISSING:
            return converted
    raise InvalidInput(
        f"`{key}` must be {_describe(kind)}; got something else.",
        field=f"config.{key}",
        hint="Correct it, or leave it out for the default.",
    )


def _converted(kind: object, value: object) -> Any:
    """Returns the value converted to a type, MISSING when it has another."""
    if get_origin(kind) is tuple:
        listed = value if isinstance(value, list | tuple) else [value]
        items = tuple(_converted(get_args(kind)[0], each) for each in listed)
        return MISSING if MISSING in items else items
    if kind in (int, float):
        return _number(kind, value)
    if kind == dict[str, Any]:
        return dict(value) if isinstance(value, Mapping) else MISSING
    if isinstance(kind, type) and is_dataclass(kind):
        return parse(kind, value) if isinstance(value, Mapping) else MISSING
    is_known = (
        isinstance(value, str) and value in get_args(kind) if get_origin(kind) is Literal else type(value) is kind
    )
    return value if is_known else MISSING


def _number(kind: object, value: object) -> Any:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < _HUGE:
        return MISSING
    if kind is int:
        return int(value) if value == int(value) else MISSING
    return float(value)


def _describe(kind: object) -> str:
    if get_origin(kind) in _UNIONS:
        return " or ".join(map(_describe, get_args(kind)))
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(get_args(kind)) if len(get_args(kind)) > 1 else str(get_args(kind)[0])
    if get_origin(kind) is tuple:
        items: dict[object, str] = {str: "strings", int: "whole numbers", float: "finite numbers"}
        return f"a list of {items.get(get_args(kind)[0], 'objects')}"
    names: dict[object, str] = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a string"}
    return names.get(kind, "an object")
