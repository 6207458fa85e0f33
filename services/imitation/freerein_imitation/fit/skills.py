"""Fit of skills."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freerein.data import labels
from freerein.learning.fit import FitResult
from freerein.learning.model_files import choose_device, save_model
from freerein_imitation.fit.dataset import FitDataset, fit_entries
from freerein_imitation.model.skills import SkillsNetwork, SkillsPolicy
from freerein_imitation.training.skills import TERMINATION_THRESHOLD, SkillsConfig, SkillsLearner


def resolve(source: FitDataset, values: Mapping[str, Any]) -> SkillsConfig:
    """Returns the complete configuration of a fit; raises as `freerein_imitation.fit.resolve`."""
    config = SkillsConfig.from_mapping(values)
    config.network_spec(source.sizes(config.camera), labels.info(source.root).skills)
    return config


def prepare(source: FitDataset, values: Mapping[str, Any], device: str) -> SkillsLearner:
    """Returns the learner of a fit."""
    config = SkillsConfig.from_mapping(values)
    labelled = labels.all_labels(source.root, source.dataset.lengths)
    return SkillsLearner.prepare(
        config,
        source.sizes(config.camera),
        source.trajectories(config.camera),
        labelled,
        skills=labels.info(source.root).skills,
        fingerprint=f"{source.dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=choose_device(device),
    )


def save(folder: Path, source: FitDataset, learner: SkillsLearner, fitted: FitResult[SkillsNetwork]) -> None:
    """Writes the fitted model as a folder."""
    losses = learner.validation_losses(fitted.network)
    figures = {
        "action_loss": losses.action.item(),
        "termination_loss": losses.termination.item(),
        "segments": len(learner.training) + len(learner.validation),
    }
    limit = learner.max_steps_per_skill
    card = {
        "kind": SkillsPolicy.kind,
        **source.control(reached_threshold=TERMINATION_THRESHOLD, max_steps_per_goal=limit),
        "command": "freerein fit imitation DATASET --set policy=skills",
        **fit_entries(source, learner.config, fitted, fingerprint=learner.fingerprint, **figures),
        "labels": asdict(labels.info(source.root)),
        "supervision": "images and executed actions of demonstrations, and skills predicted from tags",
    }
    save_model(fitted.network, folder, card=card)
