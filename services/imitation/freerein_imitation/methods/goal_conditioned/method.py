"""The method `goal_conditioned`."""

from freerein_imitation.methods.goal_conditioned.config import GoalConditionedConfig
from freerein_imitation.methods.goal_conditioned.losses import GoalConditionedLearner
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.methods.shared.goal_images.method import goal_images_method

METHOD = goal_images_method(
    GoalConditionedConfig,
    GoalConditionedSpec,
    GoalConditionedNetwork,
    GoalConditionedLearner,
    spec_fields=lambda config: {"forward_model": config.forward_consistency_weight > 0},
)
