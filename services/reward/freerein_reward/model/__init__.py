"""The dual encoder: image encoder, text encoder, tokenizer, inference, loading."""

from freerein_reward.model.dual_encoder import DualEncoder, channels_last
from freerein_reward.model.dual_encoder_model import DualEncoderModel, preprocess
from freerein_reward.model.grounding import GradCamModel, PhraseLocations, contrast_texts
from freerein_reward.model.loading import GROUNDING, REWARD, load, load_grounding
from freerein_reward.model.spec import DualEncoderSpec

__all__ = [
    "GROUNDING",
    "REWARD",
    "DualEncoder",
    "DualEncoderModel",
    "DualEncoderSpec",
    "GradCamModel",
    "PhraseLocations",
    "channels_last",
    "contrast_texts",
    "load",
    "load_grounding",
    "preprocess",
]
