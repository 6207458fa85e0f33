"""The segmentation network of chapter 2, and loading of trained ones."""

from freerein_segmentation.model.network import Context, ModelSpec, SegmentationNetwork
from freerein_segmentation.model.segmentation_model import Prediction, SegmentationModel, load

__all__ = ["Context", "ModelSpec", "Prediction", "SegmentationModel", "SegmentationNetwork", "load"]
