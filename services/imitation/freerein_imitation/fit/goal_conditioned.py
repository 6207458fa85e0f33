"""A fit of a goal-conditioned policy."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from freerein.data import Dataset
from freerein.data.lookup import choose_camera
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.fit import FitResult, fit
from freerein.learning.model_files import choose_device, save_model
from freerein_imitation.fit.source import Source, timestep
from freerein_imitation.model import GoalConditionedNetwork, GoalConditionedPolicy, Handshake
from freerein_imitation.training import goal_conditioned
from freerein_imitation.training.exploration import Exploration, hold_out
from freerein_imitation.training.goal_conditioned import GoalConditionedConfig, GoalConditionedLearner


def resolve(source: Source, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration of a fit on a dataset.

    Raises:
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
    """
    config = GoalConditionedConfig.from_mapping(values)
    config = replace(config, camera=choose_camera(source.dataset, config.camera))
    choices = source.dataset.spec.action.choices
    goal_conditioned.design(config, timestep(source.dataset, config.camera), action_choices=choices)
    return asdict(config)


def train(folder: Path, source: Source, values: Mapping[str, Any], device: str) -> bool:
    """Writes the model into the fit's folder and returns True, or returns False when it was stopped before."""
    learner = _learner(source.dataset, GoalConditionedConfig.from_mapping(values), device)
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop)
    if fitted is None:
        return False
    save_model(fitted.network, folder / "model", card=_card(source.dataset, learner, fitted))
    return True


def _learner(dataset: Dataset, config: GoalConditionedConfig, device: str) -> GoalConditionedLearner:
    exploration = Exploration(dataset.cached_frames(config.camera), dataset.cached_actions())
    training, validation = hold_out(
        exploration, share=config.validation_fraction, seed=config.seed, shortest=config.shortest_slice + 1
    )
    spec = goal_conditioned.design(config, training, action_choices=dataset.spec.action.choices)
    return GoalConditionedLearner(config, spec, training, validation, dataset.fingerprint, choose_device(device))


def _card(
    dataset: Dataset, learner: GoalConditionedLearner, fitted: FitResult[GoalConditionedNetwork]
) -> dict[str, Any]:
    held_out = goal_conditioned.evaluate(fitted.network, learner.validation, config=learner.config)
    handshake = Handshake(
        action=dataset.spec.action,
        control_dt_s=1 / dataset.spec.fps,
        reached_threshold=goal_conditioned.reached_threshold(fitted.network, learner.validation),
        max_steps_per_goal=2 * learner.config.longest_slice,
    )
    return {
        "kind": GoalConditionedPolicy.kind,
        **handshake.to_card(),
        "command": "freerein fit imitation DATASET",
        "task": dataset.spec.task,
        "data": {"trajectories": len(dataset), "fingerprint": dataset.fingerprint},
        "config": asdict(learner.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            "action_loss": held_out.action.item(),
            "goal_loss": held_out.recognition.item(),
        },
        "supervision": "images and executed actions of exploration",
    }
