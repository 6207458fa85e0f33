"""Training of the segmentation network from images, executed actions, and the set of skills of each trajectory."""

from freerein_segmentation.training.action_loss import held_out_action_loss
from freerein_segmentation.training.batches import TrajectoryBatch, gather
from freerein_segmentation.training.confidence import Confidence
from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.learner import SegmentationLearner
from freerein_segmentation.training.self_training import fit_action_model

__all__ = [
    "Confidence",
    "SegmentationConfig",
    "SegmentationLearner",
    "TrajectoryBatch",
    "fit_action_model",
    "gather",
    "held_out_action_loss",
]
