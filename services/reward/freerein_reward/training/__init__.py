"""Training of the grounding model on synthetic objects, and of reward models on its captions."""

from freerein_reward.training.caption_checks import accuracy_warnings as accuracy_warnings
from freerein_reward.training.caption_checks import caption_warnings as caption_warnings
from freerein_reward.training.caption_checks import check_shown as check_shown
from freerein_reward.training.caption_dataset import CaptionDataset as CaptionDataset
from freerein_reward.training.caption_dataset import caption_images as caption_images
from freerein_reward.training.config import GroundingConfig as GroundingConfig
from freerein_reward.training.config import RewardConfig as RewardConfig
from freerein_reward.training.evaluation import evaluate_grounding as evaluate_grounding
from freerein_reward.training.evaluation import evaluate_reward as evaluate_reward
from freerein_reward.training.grounding_learner import GroundingLearner as GroundingLearner
from freerein_reward.training.known_phrases import evaluate_known_phrases as evaluate_known_phrases
from freerein_reward.training.reward_model_learner import RewardModelLearner as RewardModelLearner
from freerein_reward.training.reward_model_learner import network_spec as network_spec
