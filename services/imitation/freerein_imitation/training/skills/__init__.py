"""How skills are cloned: from images, executed actions, and the labels that a segmentation model predicted."""

from freerein_imitation.training.skills.config import SkillsConfig
from freerein_imitation.training.skills.learner import SkillsLearner, design, prepare
from freerein_imitation.training.skills.segments import Batch, Segment, Segments, cut, gather, hold_out, see
from freerein_imitation.training.skills.updates import END_THRESHOLD, Losses, State, evaluate, losses, update

__all__ = [
    "END_THRESHOLD",
    "Batch",
    "Losses",
    "Segment",
    "Segments",
    "SkillsConfig",
    "SkillsLearner",
    "State",
    "cut",
    "design",
    "evaluate",
    "gather",
    "hold_out",
    "losses",
    "prepare",
    "see",
    "update",
]
