"""The bounds that the `.proto` files give to the fields of requests: how many elements, how many characters."""

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from google.protobuf.descriptor import FieldDescriptor

from freerein.api.common.v1 import common_pb2
from freerein.errors import InvalidInput


class Bounds(NamedTuple):
    """Bounds of a field; 0 for none.

    Attributes:
        max_items: Elements of a list, or entries of a map.
        max_length: Characters of a string, of each string of a list, or of each key of a map; bytes of a `Struct` as
            JSON.
    """

    max_items: int
    max_length: int


def bounds_of(field: FieldDescriptor) -> Bounds:
    """Returns the bounds of a field."""
    options = field.GetOptions().Extensions
    return Bounds(options[common_pb2.max_items], options[common_pb2.max_length])


def datatypes_of(field: FieldDescriptor) -> tuple[str, ...]:
    """Returns the datatypes that a field may have, a `Tensor` or a map of them; empty where the contract names none."""
    return tuple(field.GetOptions().Extensions[common_pb2.datatypes].split())


def check_bounds(value: Any, bounds: Bounds, path: str) -> None:
    """Raises InvalidInput when a string, list or map, of the dotted name `path`, is beyond its bounds."""
    if bounds.max_items and len(value) > bounds.max_items:
        raise _too_long(path, f"{bounds.max_items} elements", len(value))
    if bounds.max_length:
        for name, text in _texts(value, path):
            if len(text) > bounds.max_length:
                raise _too_long(name, f"{bounds.max_length} characters", len(text))


def check_json_bytes(struct: Mapping[str, Any], bounds: Bounds, path: str) -> None:
    """Raises InvalidInput when a `Struct` takes too many bytes as JSON."""
    size = len(json.dumps(struct, separators=(",", ":"), ensure_ascii=False).encode(errors="replace"))
    if size > bounds.max_length:
        raise _too_long(path, f"{bounds.max_length} bytes as JSON", size)


def _texts(value: Any, path: str) -> Iterable[tuple[str, str]]:
    """Yields the strings of a field with their dotted names; the keys of a map are not repeated in its errors."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, Mapping):
        yield from ((path, key) for key in value)
    else:
        yield from ((f"{path}.{index}", text) for index, text in enumerate(value))


def _too_long(path: str, most: str, got: int) -> InvalidInput:
    return InvalidInput(f"`{path}` may have at most {most}; got {got}.", field=path, hint="Send less.")
