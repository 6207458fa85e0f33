"""The method `goal_cloning`."""

from typing import Any

import torch

from freerein.data import read_teachers
from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein.learning.training_loop import FitResult
from freerein_imitation.methods.goal_cloning.config import GoalCloningConfig
from freerein_imitation.methods.goal_cloning.losses import GoalCloningLearner
from freerein_imitation.methods.goal_cloning.network import GoalCloningNetwork, GoalCloningSpec
from freerein_imitation.methods.goal_cloning.policy import GoalCloningPolicy
from freerein_imitation.methods.shared.supervision import supervision_of
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import loader

_REACHED_THRESHOLD = 0.4
_GOAL_STEPS_FACTOR = 3


def _prepare(source: FitDataset, config: GoalCloningConfig, device: torch.device) -> GoalCloningLearner:
    training, validation = source.trajectories(config.cameras).split(
        fraction=config.validation_fraction, seed=config.seed, min_length=config.max_goal_steps + 2
    )
    fingerprint = source.dataset.fingerprint
    return GoalCloningLearner(config, _spec(source, config), training, validation, fingerprint, device)


def _card(source: FitDataset, learner: GoalCloningLearner, fitted: FitResult[GoalCloningNetwork]) -> dict[str, Any]:
    losses = learner.validation_losses(fitted.network)
    control = ControlSpec(
        source.dataset.spec.control_dt_s, _REACHED_THRESHOLD, _GOAL_STEPS_FACTOR * learner.config.max_goal_steps
    )
    figures = {name: loss.item() for name, loss in losses.items()}
    return {
        **control.to_card(),
        "figures": fitted.figures | figures,
        **supervision_of("images and executed actions of exploration", read_teachers(source.root)),
        "warnings": learner.warnings(fitted.network),
    }


def _spec(source: FitDataset, config: GoalCloningConfig) -> GoalCloningSpec:
    cameras, action = source.cameras(config.cameras), source.dataset.spec.action
    if action.absolute:
        raise InvalidInput(
            "goal_cloning needs actions that are changes of position; those of this dataset are targets.",
            field="dataset",
            hint="Choose another method, such as goal_conditioned.",
        )
    return spec_of(config, GoalCloningSpec, cameras=cameras, action=action)


_load = loader(GoalCloningPolicy, GoalCloningSpec, GoalCloningNetwork)
METHOD = Method(GoalCloningConfig, _spec, _prepare, _card, _load)
