"""Configurations: as JSON, and compared modulo the defaults of keys that a stored one lacks."""

import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from freerein.learning.checkpoints import JSON

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Config: TypeAlias = "Mapping[str, object] | DataclassInstance"
"""JSON, in which dataclasses may stand for objects: their keys may have defaults."""


def to_json(config: object) -> Any:
    """Returns a configuration as it comes back from a JSON file."""
    return json.loads(json.dumps(config, default=asdict))


def is_same(stored: JSON, present: object) -> bool:
    """Returns whether a stored configuration is the present one.

    Every stored value must be the present one. A key that the stored one lacks is as its dataclass has it by default:
    a key that is added does by default what was done before it.
    """
    if is_dataclass(present) and isinstance(stored, dict):
        keys = [each.name for each in fields(present)]
        return is_same({**_defaults(present), **stored}, {key: getattr(present, key) for key in keys})
    if isinstance(present, Mapping) and isinstance(stored, dict):
        return stored.keys() == present.keys() and all(is_same(stored[key], present[key]) for key in present)
    if isinstance(present, list | tuple) and isinstance(stored, list):
        return len(stored) == len(present) and all(map(is_same, stored, present))
    return bool(stored == present)


def _defaults(config: Any) -> dict[str, JSON]:
    """Returns the defaults of a dataclass's keys, as JSON; keys without one are left out."""
    defaults = {each.name: each.default for each in fields(config) if each.default is not MISSING}
    made = {each.name: each.default_factory() for each in fields(config) if each.default_factory is not MISSING}
    return dict(to_json(defaults | made))
