"""Core of the reward service: `RewardCore`, `RewardStreamService` and `GroundingCore`.

reward_stream -> reward | grounding -> inputs | inference -> goal_cache -> models
"""

from freerein_reward.core.goal_cache import GoalCache as GoalCache
from freerein_reward.core.grounding import GroundingCore as GroundingCore
from freerein_reward.core.inference import Inference as Inference
from freerein_reward.core.inference import InferenceBatcher as InferenceBatcher
from freerein_reward.core.models import GroundingModel as GroundingModel
from freerein_reward.core.models import RewardModel as RewardModel
from freerein_reward.core.reward_core import RewardCore as RewardCore
from freerein_reward.core.reward_stream import RewardStreamService as RewardStreamService
