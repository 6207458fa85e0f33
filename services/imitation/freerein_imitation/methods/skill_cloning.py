"""Skill policies, for recipes: behavioural cloning of labelled segments (section 2.4), of any robot and scene."""

from dataclasses import asdict
from typing import Any

import torch

from freerein.data import labels
from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.skill_cloning import SkillCloningNetwork, SkillCloningPolicy, SkillCloningSpec
from freerein_imitation.training.skill_cloning import SkillCloningConfig, SkillCloningLearner, network_spec


def _resolve(source: FitDataset, config: SkillCloningConfig) -> SkillCloningConfig:
    _spec(source, config)  # rejects frames and actions that are out of bounds, and a dataset without labels
    return config


def _prepare(source: FitDataset, config: SkillCloningConfig, device: torch.device) -> SkillCloningLearner:
    labelled = labels.all_labels(source.root, source.dataset.lengths)
    return SkillCloningLearner.prepare(
        config,
        _spec(source, config),
        source.trajectories(config.cameras),
        labelled,
        fingerprint=f"{source.dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=device,
    )


def _card(source: FitDataset, learner: SkillCloningLearner, fitted: FitResult[SkillCloningNetwork]) -> dict[str, Any]:
    losses, limits = learner.validation_losses(fitted.network), learner.step_limits()
    figures = {
        "action_loss": losses.action.item(),
        "termination_loss": losses.termination.item(),
        "segments": len(learner.segments),
    }
    threshold = learner.termination_threshold(fitted.network) if learner.config.ends == "head" else 1.0
    control = ControlSpec(1 / source.dataset.spec.fps, threshold, max(limits), max_steps_per_skill=limits)
    return {
        **control.to_card(),
        "figures": fitted.figures | figures,
        "labels": asdict(labels.info(source.root)),
        "supervision": "images and executed actions of demonstrations, and skills predicted from tags",
    }


def _spec(source: FitDataset, config: SkillCloningConfig) -> SkillCloningSpec:
    return network_spec(
        config,
        cameras=source.cameras(config.cameras),
        action=source.dataset.spec.action,
        skills=labels.info(source.root).skills,
    )


METHOD = Method(SkillCloningConfig, _resolve, _prepare, _card, SkillCloningPolicy.load, SkillCloningLearner.calibrate)
