"""How a goal-conditioned policy and its recognizer learn: from images and executed actions, and from nothing else."""

from freerein_imitation.training.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.training.goal_conditioned.learner import GoalConditionedLearner, design
from freerein_imitation.training.goal_conditioned.slices import Moments, Slices, draw_moments, draw_slices
from freerein_imitation.training.goal_conditioned.threshold import reached_threshold
from freerein_imitation.training.goal_conditioned.updates import Losses, State, evaluate, init, losses, update

__all__ = [
    "GoalConditionedConfig",
    "GoalConditionedLearner",
    "Losses",
    "Moments",
    "Slices",
    "State",
    "design",
    "draw_moments",
    "draw_slices",
    "evaluate",
    "init",
    "losses",
    "reached_threshold",
    "update",
]
