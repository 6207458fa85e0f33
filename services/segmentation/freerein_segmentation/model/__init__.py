"""The segmentation network of chapter 2, and loading of trained ones."""

from freerein_segmentation.model.lookahead import MAX_CONTEXT, Context
from freerein_segmentation.model.network import ModelSpec, SegmentationNetwork
from freerein_segmentation.model.segmentation_model import SegmentationModel, load
from freerein_segmentation.model.stream import Prediction, SegmentationStream

__all__ = [
    "MAX_CONTEXT",
    "Context",
    "ModelSpec",
    "Prediction",
    "SegmentationModel",
    "SegmentationNetwork",
    "SegmentationStream",
    "load",
]
