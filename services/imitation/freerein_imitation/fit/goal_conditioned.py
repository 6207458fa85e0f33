"""Fit of a goal-conditioned policy."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freerein.learning.fit import FitResult
from freerein.learning.model_files import choose_device, save_model
from freerein_imitation.fit.dataset import FitDataset, fit_entries
from freerein_imitation.model.goal_conditioned import GoalConditionedNetwork, GoalConditionedPolicy
from freerein_imitation.training.goal_conditioned import (
    GoalConditionedConfig,
    GoalConditionedLearner,
    reached_threshold,
)


def resolve(source: FitDataset, values: Mapping[str, Any]) -> GoalConditionedConfig:
    """Returns the complete configuration of a fit; raises as `freerein_imitation.fit.resolve`."""
    config = GoalConditionedConfig.from_mapping(values)
    config.network_spec(source.sizes(config.camera))
    return config


def prepare(source: FitDataset, values: Mapping[str, Any], device: str) -> GoalConditionedLearner:
    """Returns the learner of a fit."""
    config = GoalConditionedConfig.from_mapping(values)
    return GoalConditionedLearner.prepare(
        config,
        source.sizes(config.camera),
        source.trajectories(config.camera),
        fingerprint=source.dataset.fingerprint,
        device=choose_device(device),
    )


def save(
    folder: Path, source: FitDataset, learner: GoalConditionedLearner, fitted: FitResult[GoalConditionedNetwork]
) -> None:
    """Writes the fitted model as a folder."""
    network, config = fitted.network, learner.config
    losses = learner.validation_losses(network)
    threshold = reached_threshold(network, learner.validation)
    figures = {"action_loss": losses.action.item(), "recognizer_loss": losses.recognizer.item()}
    card = {
        "kind": GoalConditionedPolicy.kind,
        **source.control(reached_threshold=threshold, max_steps_per_goal=2 * config.max_goal_steps),
        "command": "freerein fit imitation DATASET",
        **fit_entries(source, config, fitted, fingerprint=learner.fingerprint, **figures),
        "supervision": "images and executed actions of exploration",
    }
    save_model(network, folder, card=card)
