"""Tensors as plain lists of numbers, nested by axis, which any language can write and read."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from freerein import tensors, wire

PARAMETER, LIST = "tensors", "list"
"""Query parameter of a call, and its value, for tensors of the reply as lists."""

MAX_LISTED = 100_000
"""Elements of a tensor from which it is sent in base64 in any case."""

_NUMBERS, _WHOLE, _TRUTH = frozenset((int, float)), frozenset((int,)), frozenset((bool,))
_NAMES = {_NUMBERS: "numbers", _WHOLE: "whole numbers", _TRUTH: "true and false"}


class OrList:
    """Lets a list of numbers stand for a `Tensor` of some datatypes, in a pydantic model and its JSON schema."""

    def __init__(self, datatypes: Sequence[str]) -> None:
        self._datatypes = datatypes

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Returns the schema of a `Tensor`, before which a list becomes one."""
        return core_schema.no_info_before_validator_function(self._tensor, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Returns the JSON schema: a `Tensor`, or an array."""
        return {"anyOf": [handler(schema), {"type": "array", "items": {}}]}

    def _tensor(self, value: object) -> object:
        return tensor_of(value, self._datatypes) if isinstance(value, list) else value


def tensor_of(nested: Sequence[object], datatypes: Sequence[str]) -> dict[str, Any]:
    """Returns a list, nested by axis, as the fields of a `Tensor`.

    Whole numbers are INT64 where `datatypes` has that; else the datatype is the first.

    Raises:
        ValueError: Lengths differ, there are too many axes, or elements have not the datatype.
    """
    shape, elements = _flattened(nested)
    types = frozenset(map(type, elements))
    name = "INT64" if "INT64" in datatypes and types == {int} else datatypes[0]
    allowed = _TRUTH if name == "BOOL" else _NUMBERS if name.startswith("FP") else _WHOLE
    if not types <= allowed:
        raise ValueError(f"as a list must hold only {_NAMES[allowed]}, for {name}")
    try:
        with np.errstate(over="ignore"):
            array = np.array(elements, np.float64 if name.startswith("FP") else None).astype(tensors.DTYPES[name])
    except OverflowError:
        raise ValueError(f"holds a number that is out of the range of {name}") from None
    if elements and not _is_exact(array, elements):
        raise ValueError(f"holds a number that is out of the range of {name}")
    return {"datatype": name, "shape": shape, "raw": array.tobytes()}


def reply_json(response: object, *, write_bytes: Callable[[Any], str] = wire.base64_text) -> dict[str, Any]:
    """Returns a reply as JSON values, its tensors as lists; those of more than `MAX_LISTED` elements are as ever."""

    def listed(array: npt.NDArray[Any]) -> object:
        return array.tolist() if array.size <= MAX_LISTED else wire.tensor_json(array, write_bytes=write_bytes)

    return wire.to_json(response, write_tensor=listed, write_bytes=write_bytes)


def _flattened(nested: Sequence[object]) -> tuple[list[int], list[Any]]:
    """Returns the shape of a nested list, and its elements; raises ValueError where it has none."""
    shape: list[int] = []
    level: list[Any] = [nested]
    while level and all(isinstance(each, list) for each in level) and len(shape) < tensors.MAX_AXES:
        shape.append(len(level[0]))
        if any(len(each) != shape[-1] for each in level):
            raise ValueError("as a list must be nested evenly: lists of one level must have one length")
        level = [element for each in level for element in each]
    if any(isinstance(each, list) for each in level):
        raise ValueError(f"as a list must be nested evenly, at most {tensors.MAX_AXES} levels deep")
    return shape, level


def _is_exact(array: npt.NDArray[Any], elements: Sequence[float]) -> bool:
    """Returns whether numbers kept their value, but for the rounding of floats."""
    if array.dtype.kind == "f":
        return bool(np.isfinite(array).all())
    return bool(array.min() == min(elements) and array.max() == max(elements))
