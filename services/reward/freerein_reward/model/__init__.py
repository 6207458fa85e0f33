"""The dual encoders: their towers, the tokenizer, and trained ones as folders."""

from freerein_reward.model.dual_encoder import DualEncoder, DualEncoderSpec, channels_last
from freerein_reward.model.grounding import GroundingModel, Grounds, contrast
from freerein_reward.model.preprocess import Preprocess
from freerein_reward.model.similarity import RewardModel
from freerein_reward.model.trained import GROUNDING, REWARD, load, load_grounding

__all__ = [
    "GROUNDING",
    "REWARD",
    "DualEncoder",
    "DualEncoderSpec",
    "GroundingModel",
    "Grounds",
    "Preprocess",
    "RewardModel",
    "channels_last",
    "contrast",
    "load",
    "load_grounding",
]
