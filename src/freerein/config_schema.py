"""JSON schemas of configurations, for people and programs that write them; `config.parse` is what checks them."""

import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, fields, is_dataclass
from inspect import getattr_static
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

_TYPES: Mapping[object, str] = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}
_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def config_schema(kind: Any, *, title: str = "", more: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Returns the JSON schema of a configuration.

    Args:
        kind: Its dataclass, as `config.parse` takes it, whose docstrings describe its attributes.
        title: What it is called.
        more: Schemas of keys beside those of the dataclass.
    """
    types, meanings, properties, needed = get_type_hints(kind), _meanings_of(kind), dict(more or {}), []
    for each in fields(kind):
        bounds, default = getattr_static(kind, each.name, None), _default_of(each)
        limits = bounds.limits() if hasattr(bounds, "limits") else {}
        described = {**_schema_of(types[each.name], limits), "description": meanings.get(each.name, "")}
        properties[each.name] = described if default is MISSING else {**described, "default": default}
        needed += [each.name] if default is MISSING else []
    shown = {"title": title} if title else {}
    return {"type": "object", **shown, "properties": properties, "required": needed, "additionalProperties": False}


def _schema_of(kind: Any, limits: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the schema of a value of a type within limits."""
    if get_origin(kind) in (Union, UnionType):
        return {"anyOf": [_schema_of(each, limits) for each in get_args(kind)]}
    if get_origin(kind) is Literal:
        return {"enum": list(get_args(kind))}
    if get_origin(kind) is tuple:
        return {"type": "array", "items": _schema_of(get_args(kind)[0], limits)}
    if is_dataclass(kind):
        return config_schema(kind)
    if kind not in _TYPES:
        return {"type": "object"}
    return {"type": _TYPES[kind], **({} if kind is NoneType else limits)}


def _default_of(each: Field[Any]) -> Any:
    value = each.default if each.default_factory is MISSING else each.default_factory()
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _meanings_of(kind: type) -> dict[str, str]:
    """Returns what docstrings say of the attributes of a class and its bases, by name."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, attributes = (inspect.getdoc(each) or "").partition("Attributes:\n")
        found |= {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(attributes)}
    return found
