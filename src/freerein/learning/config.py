"""Strict parsing of a training's configuration: one frozen dataclass, its fields' types and bounds, no unknown keys."""

import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, field, fields
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from freerein.errors import InvalidInput

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

C = TypeVar("C", bound="DataclassInstance")
N = TypeVar("N", int, float)


def bounded(default: N, *, least: float, most: float = math.inf) -> N:
    """Returns a dataclass field for a number in [least, most]."""
    made: N = field(default=default, metadata={"least": least, "most": most})
    return made
