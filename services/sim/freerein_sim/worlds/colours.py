"""Colours of things that MuJoCo worlds tell apart by colour alone."""

from collections.abc import Mapping
from types import MappingProxyType

RGBA: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {
        "red": (0.86, 0.09, 0.07, 1),
        "green": (0.12, 0.66, 0.16, 1),
        "yellow": (0.98, 0.80, 0.06, 1),
        "blue": (0.10, 0.30, 0.92, 1),
    }
)
"""By name: red, green, blue and opacity in [0, 1]."""
