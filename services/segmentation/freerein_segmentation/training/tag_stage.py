"""A stage of a segmentation fit."""

from dataclasses import dataclass

from freerein.learning.learner import Stage
from freerein_segmentation.model import Context, SegmentationNetwork
from freerein_segmentation.objectives import Objective


@dataclass(frozen=True, kw_only=True)
class TagStage(Stage[SegmentationNetwork]):
    """A stage, and how held-out trajectories are judged after its steps.

    Attributes:
        objective: Loss of their tags.
        context: Future timesteps, one stride apart, that scores depend on, in training, too.
    """

    objective: Objective
    context: Context
