"""How the segmentation network learns: from images, executed actions, and the set of skills of each trajectory."""

from freerein_segmentation.training.config import SegmentationConfig
from freerein_segmentation.training.demonstrations import Batch, Demonstrations, Trajectories, gather, hold_out
from freerein_segmentation.training.learner import SegmentationLearner, design
from freerein_segmentation.training.updates import State, evaluate, init, update

__all__ = [
    "Batch",
    "Demonstrations",
    "SegmentationConfig",
    "SegmentationLearner",
    "State",
    "Trajectories",
    "design",
    "evaluate",
    "gather",
    "hold_out",
    "init",
    "update",
]
