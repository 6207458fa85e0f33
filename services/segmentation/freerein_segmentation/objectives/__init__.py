"""Weakly supervised losses of chapter 2, by name: scores pooled over time against the tags, or constrained labels.

A new objective is a module here and a line in `OBJECTIVES`, with its import.
"""

from collections.abc import Mapping
from types import MappingProxyType

from freerein_segmentation.objectives.ccnn import ccnn, ccnn_without_share
from freerein_segmentation.objectives.lse import lse, lse_per_timestep
from freerein_segmentation.objectives.mil import fcn_mil, mil
from freerein_segmentation.objectives.tags import Objective

__all__ = ["OBJECTIVES", "Objective"]

OBJECTIVES: Mapping[str, Objective] = MappingProxyType(
    {
        "lse": lse,
        "lse_per_timestep": lse_per_timestep,
        "mil": mil,
        "fcn_mil": fcn_mil,
        "ccnn": ccnn,
        "ccnn_without_share": ccnn_without_share,
    }
)
