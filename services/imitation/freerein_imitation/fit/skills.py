"""A fit of skills."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from freerein.data import labels
from freerein.data.lookup import choose_camera
from freerein.jobs.child import stop_on_sigterm
from freerein.learning.fit import FitResult, fit
from freerein.learning.model_files import choose_device, save_model
from freerein_imitation.fit.source import Source, timestep
from freerein_imitation.model import Handshake, SkillsNetwork, SkillsPolicy
from freerein_imitation.training import skills
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.skills import SkillsConfig, SkillsLearner


def resolve(source: Source, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration of a fit on a dataset.

    Raises:
        InvalidInput: The configuration is wrong, or the dataset cannot be learned from.
        FailedPrecondition: The dataset is not labelled.
    """
    config = SkillsConfig.from_mapping(values)
    config = replace(config, camera=choose_camera(source.dataset, config.camera))
    vocabulary, choices = labels.info(source.root).skills, source.dataset.spec.action.choices
    skills.design(config, timestep(source.dataset, config.camera), skills=vocabulary, action_choices=choices)
    return asdict(config)


def train(folder: Path, source: Source, values: Mapping[str, Any], device: str) -> bool:
    """Writes the model into the fit's folder and returns True, or returns False when it was stopped before."""
    learner = _learner(source, SkillsConfig.from_mapping(values), device)
    with stop_on_sigterm() as stop:
        fitted = fit(learner, folder, stop=stop)
    if fitted is None:
        return False
    save_model(fitted.network, folder / "model", card=_card(source, learner, fitted))
    return True


def _learner(source: Source, config: SkillsConfig, device: str) -> SkillsLearner:
    dataset = source.dataset
    labelled = labels.all_labels(source.root, dataset.lengths)
    torch.set_num_threads(config.threads)
    return skills.prepare(
        config,
        Exploration(dataset.cached_frames(config.camera), dataset.cached_actions()),
        labelled,
        skills=labels.info(source.root).skills,
        action_choices=dataset.spec.action.choices,
        fingerprint=f"{dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=choose_device(device),
    )


def _card(source: Source, learner: SkillsLearner, fitted: FitResult[SkillsNetwork]) -> dict[str, Any]:
    held_out = skills.evaluate(fitted.network, learner.validation, config=learner.config)
    handshake = Handshake(
        action=source.dataset.spec.action,
        control_dt_s=1 / source.dataset.spec.fps,
        reached_threshold=skills.END_THRESHOLD,
        max_steps_per_goal=learner.max_steps_per_skill,
    )
    return {
        "kind": SkillsPolicy.kind,
        **handshake.to_card(),
        "command": "freerein fit imitation DATASET --set policy=skills",
        "task": source.dataset.spec.task,
        "data": {"trajectories": len(source.dataset), "fingerprint": learner.fingerprint},
        "labels": asdict(labels.info(source.root)),
        "config": asdict(learner.config),
        "figures": {
            "validation_loss": fitted.validation_loss,
            "best_step": fitted.best_step,
            "action_loss": held_out.action.item(),
            "end_loss": held_out.end.item(),
            "segments": len(learner.training) + len(learner.validation),
        },
        "supervision": "images and executed actions of demonstrations, and skills predicted from tags",
    }
