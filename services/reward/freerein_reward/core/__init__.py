"""What the reward service answers: `Rewarder` and `Finder`, around models of two kinds.

rewarder -> frames | texts -> inference -> goal_cache -> models
finder -> pictures | texts | captions -> inference
"""

from freerein_reward.core.finder import GROUNDING as GROUNDING
from freerein_reward.core.finder import Finder as Finder
from freerein_reward.core.goal_cache import GoalCache as GoalCache
from freerein_reward.core.inference import Inference as Inference
from freerein_reward.core.inference import Item as Item
from freerein_reward.core.inference import Output as Output
from freerein_reward.core.models import GroundingModel as GroundingModel
from freerein_reward.core.models import Loaded as Loaded
from freerein_reward.core.models import Model as Model
from freerein_reward.core.models import Preprocess as Preprocess
from freerein_reward.core.models import RewardModel as RewardModel
from freerein_reward.core.rewarder import Rewarder as Rewarder
