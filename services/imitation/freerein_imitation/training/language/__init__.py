"""How a language policy learns: from images, executed actions and goal texts of policies that learned single tasks."""

from freerein_imitation.training.language.config import LanguageConfig
from freerein_imitation.training.language.learner import LanguageLearner, design, prepare
from freerein_imitation.training.language.rollouts import Batch, Rollouts, hold_out, random_crop
from freerein_imitation.training.language.updates import State, action_loss, evaluate, update

__all__ = [
    "Batch",
    "LanguageConfig",
    "LanguageLearner",
    "Rollouts",
    "State",
    "action_loss",
    "design",
    "evaluate",
    "hold_out",
    "prepare",
    "random_crop",
    "update",
]
