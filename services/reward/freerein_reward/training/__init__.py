"""How the two kinds of models are trained: the grounding model on single objects, reward models on its captions."""

from freerein_reward.training.agreement import agreement
from freerein_reward.training.calibration import calibrate, measure
from freerein_reward.training.captions import describe
from freerein_reward.training.config import GroundingConfig, RewardConfig
from freerein_reward.training.described import Described, hold_out
from freerein_reward.training.grounding import GroundingLearner
from freerein_reward.training.reward import RewardLearner, design

__all__ = [
    "Described",
    "GroundingConfig",
    "GroundingLearner",
    "RewardConfig",
    "RewardLearner",
    "agreement",
    "calibrate",
    "describe",
    "design",
    "hold_out",
    "measure",
]
