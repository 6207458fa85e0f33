"""Training of the segmentation network from images, executed actions, and the set of skills of each trajectory."""

from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.demonstrations import Demonstrations, gather
from freerein_segmentation.training.learner import SegmentationLearner, network_spec

__all__ = ["Demonstrations", "SegmentationConfig", "SegmentationLearner", "gather", "network_spec"]
