"""Weakly supervised losses of chapter 2, by name; only the pooling over time differs.

A new objective is a module here and a line in `OBJECTIVES`, with its import.
"""

from collections.abc import Mapping
from types import MappingProxyType

from freerein_segmentation.objectives.lse import lse, lse_per_timestep
from freerein_segmentation.objectives.mil import mil
from freerein_segmentation.objectives.tags import Objective

__all__ = ["OBJECTIVES", "Objective"]

OBJECTIVES: Mapping[str, Objective] = MappingProxyType(
    {
        "lse": lse,
        "lse_per_timestep": lse_per_timestep,
        "mil": mil,
    }
)
