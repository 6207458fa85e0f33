"""The goal-conditioned skill policy of chapter 3, for goal images."""

from typing import Any

import torch

from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein_imitation.methods import goal_images
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.goal_images import GoalImagesPolicy
from freerein_imitation.model.torch_policy import loader
from freerein_imitation.training.goal_conditioned import GoalConditionedConfig, GoalConditionedLearner


def _prepare(source: FitDataset, config: GoalConditionedConfig, device: torch.device) -> GoalConditionedLearner:
    return goal_images.prepare(source, config, _spec(source, config), device, GoalConditionedLearner)


def _card(
    source: FitDataset, learner: GoalConditionedLearner, fitted: FitResult[GoalConditionedNetwork]
) -> dict[str, Any]:
    return goal_images.card(source, learner, fitted, max_steps_per_goal=2 * learner.config.max_goal_steps)


def _spec(source: FitDataset, config: GoalConditionedConfig) -> GoalConditionedSpec:
    cameras, action = source.cameras(config.cameras), source.dataset.spec.action
    has_forward_model = config.forward_consistency_weight > 0
    return spec_of(config, GoalConditionedSpec, cameras=cameras, action=action, forward_model=has_forward_model)


_load = loader(GoalImagesPolicy, GoalConditionedSpec, GoalConditionedNetwork)
METHOD = Method(GoalConditionedConfig, _spec, _prepare, _card, _load)
