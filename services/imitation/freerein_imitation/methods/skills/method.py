"""The method `skills`."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from freerein.data import labels
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein.learning.training_loop import FitResult
from freerein_imitation.methods.shared.skill_segments import generous_limit
from freerein_imitation.methods.skills.config import SkillsConfig
from freerein_imitation.methods.skills.losses import TERMINATION_THRESHOLD, SkillsLearner
from freerein_imitation.methods.skills.network import GRIPPER, SkillsNetwork, SkillsSpec
from freerein_imitation.methods.skills.policy import SkillsPolicy
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import loader


def _prepare(source: FitDataset, config: SkillsConfig, device: torch.device) -> SkillsLearner:
    labelled = labels.all_labels(source.root, source.dataset.lengths)
    return SkillsLearner.prepare(
        config,
        _spec(source, config),
        source.trajectories(config.cameras),
        labelled,
        fingerprint=f"{source.dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=device,
    )


def _card(source: FitDataset, learner: SkillsLearner, fitted: FitResult[SkillsNetwork]) -> dict[str, Any]:
    losses = learner.validation_losses(fitted.network)
    figures = {
        "action_loss": losses["action_loss"].item(),
        "termination_loss": losses["termination_loss"].item(),
        "segments": len(learner.segments),
    }
    control = ControlSpec(source.dataset.spec.control_dt_s, TERMINATION_THRESHOLD, generous_limit(learner.segments))
    return {
        **control.to_card(),
        "figures": fitted.figures | figures,
        "labels": asdict(labels.info(source.root)),
        "supervision": "images and executed actions of demonstrations, and skills predicted from tags",
        "warnings": [*_without_gripper(learner.spec), *_left_out(learner)],
    }


def _without_gripper(spec: SkillsSpec) -> Iterator[str]:
    """Yields a warning where no number of an action is a gripper's."""
    if not any(spec.is_gripper):
        yield (
            f"The number of an action that moves a gripper must have `{GRIPPER}` in its name; got "
            f"{', '.join(spec.action.names) or 'no names'}. Without one, a skill's object is taken to be where its "
            "segment ends, and to be put there. If the robot has a gripper, name its number so, and fit again."
        )


def _left_out(learner: SkillsLearner) -> Iterator[str]:
    """Yields a warning where trajectories taught nothing."""
    count, used = len(learner.demonstrations), np.union1d(learner.training.trajectory, learner.validation.trajectory)
    if len(used) < count:
        yield (
            f"Of {count} trajectories {count - len(used)} taught nothing: their labels show other skills than their "
            "tags, or none for `min_segment_steps`."
        )


def _spec(source: FitDataset, config: SkillsConfig) -> SkillsSpec:
    return spec_of(
        config,
        SkillsSpec,
        cameras=source.cameras(config.cameras),
        action=source.dataset.spec.action,
        skills=labels.info(source.root).skills,
    )


_load = loader(SkillsPolicy, SkillsSpec, SkillsNetwork)
METHOD = Method(SkillsConfig, _spec, _prepare, _card, _load)
