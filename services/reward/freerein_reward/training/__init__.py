"""Training of the grounding model on synthetic objects, and of reward models on its captions."""

from freerein_reward.training.caption_dataset import CaptionDataset, caption_images
from freerein_reward.training.config import GroundingConfig, RewardConfig
from freerein_reward.training.evaluation import calibrate_presence, evaluate_grounding, evaluate_reward
from freerein_reward.training.grounding_learner import GroundingLearner
from freerein_reward.training.reward_learner import RewardLearner, network_spec

__all__ = [
    "CaptionDataset",
    "GroundingConfig",
    "GroundingLearner",
    "RewardConfig",
    "RewardLearner",
    "calibrate_presence",
    "caption_images",
    "evaluate_grounding",
    "evaluate_reward",
    "network_spec",
]
