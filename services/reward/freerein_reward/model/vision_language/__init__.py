"""Vision-language models behind one interface, and phrase grounding by Grad-CAM with any of them."""

from freerein_reward.model.vision_language.built_in import BuiltIn as BuiltIn
from freerein_reward.model.vision_language.grad_cam import gradient_weights as gradient_weights
from freerein_reward.model.vision_language.grad_cam import heat_maps as heat_maps
from freerein_reward.model.vision_language.interface import TracedMaps as TracedMaps
from freerein_reward.model.vision_language.interface import VisionLanguageModel as VisionLanguageModel
from freerein_reward.model.vision_language.keypoints import KEYPOINTS as KEYPOINTS
