"""The method `skill_cloning`."""

from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from freerein.data import labels
from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein.learning.training_loop import FitResult
from freerein_imitation.methods.skill_cloning.config import SkillCloningConfig, network_spec
from freerein_imitation.methods.skill_cloning.losses import SkillCloningLearner
from freerein_imitation.methods.skill_cloning.network import SkillCloningNetwork, SkillCloningSpec
from freerein_imitation.methods.skill_cloning.policy import SkillCloningPolicy
from freerein_imitation.methods.skill_cloning.spans import RobotStates
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import loader


def _prepare(source: FitDataset, config: SkillCloningConfig, device: torch.device) -> SkillCloningLearner:
    labelled = labels.all_labels(source.root, source.dataset.lengths)
    return SkillCloningLearner.prepare(
        config,
        _spec(source, config),
        source.trajectories(config.cameras),
        labelled,
        fingerprint=f"{source.dataset.fingerprint} {labels.fingerprint(labelled)}",
        device=device,
        robot_states=_robot_states(source) if config.use_robot_state else (),
    )


def _robot_states(source: FitDataset) -> RobotStates:
    """Returns the robot's own state in each trajectory; raises InvalidInput where one is not finite."""
    states = [state for each in range(len(source.dataset)) if (state := source.dataset.robot_state(each)) is not None]
    unusable = [index for index, state in enumerate(states) if not np.isfinite(state).all()]
    if unusable:
        raise InvalidInput(
            f"The robot's state must be finite; that of {len(unusable)} trajectories is not, such as {unusable[0]}.",
            field="dataset",
            hint="Leave these trajectories out.",
        )
    return states


def _card(source: FitDataset, learner: SkillCloningLearner, fitted: FitResult[SkillCloningNetwork]) -> dict[str, Any]:
    losses, limits = learner.validation_losses(fitted.network), learner.step_limits()
    figures = {
        "action_loss": losses["action_loss"].item(),
        "termination_loss": losses["termination_loss"].item(),
        "segments": len(learner.segments),
    }
    threshold = learner.termination_threshold(fitted.network) if learner.config.ends == "head" else 1.0
    control = ControlSpec(source.dataset.spec.control_dt_s, threshold, max(limits), max_steps_per_skill=limits)
    observed = "images, the robot's own state" if learner.spec.robot_state_size else "images"
    return {
        **control.to_card(),
        "figures": fitted.figures | figures,
        "labels": asdict(labels.info(source.root)),
        "supervision": f"{observed} and executed actions of demonstrations, and skills predicted from tags",
    }


def _spec(source: FitDataset, config: SkillCloningConfig) -> SkillCloningSpec:
    return network_spec(
        config,
        cameras=source.cameras(config.cameras),
        action=source.dataset.spec.action,
        skills=labels.info(source.root).skills,
        robot_state_size=source.dataset.spec.robot_state_size,
    )


_load = loader(SkillCloningPolicy, SkillCloningSpec, SkillCloningNetwork)
METHOD = Method(SkillCloningConfig, _spec, _prepare, _card, _load)
