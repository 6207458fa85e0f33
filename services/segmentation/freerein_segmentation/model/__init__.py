"""The network of chapter 2, and trained ones as folders."""

from freerein_segmentation.model.network import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.model.trained import SegmentationModel, load

__all__ = ["Context", "ModelSpec", "SegmentationModel", "SegmentationNetwork", "load"]
