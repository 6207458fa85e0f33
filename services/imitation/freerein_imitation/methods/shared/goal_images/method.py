"""Methods that follow goal images: how a learner is prepared, what the card says, and loading."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import torch

from freerein.data import read_teachers
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein.learning.training_loop import FitResult
from freerein.types.common import ModelRef
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.losses import GoalImagesLearner, N
from freerein_imitation.methods.shared.goal_images.network import GoalImagesSpec
from freerein_imitation.methods.shared.goal_images.policy import GoalImagesPolicy
from freerein_imitation.methods.shared.goal_images.stored_recognizer import (
    StoredRecognizer,
    active_recognizer,
    load_recognizer,
)
from freerein_imitation.methods.shared.supervision import supervision_of
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import loader

_SUPERVISION = "images and executed actions of exploration"

C = TypeVar("C", bound=GoalImagesConfig)
S = TypeVar("S", bound=GoalImagesSpec)


def goal_images_method(
    config_class: type[C],
    spec_class: type[S],
    network_class: Callable[[S], N],
    learner_class: type[GoalImagesLearner[N]],
    *,
    spec_fields: Callable[[C], dict[str, Any]] = lambda _config: {},
) -> Method[C, GoalImagesLearner[N], N, GoalImagesPolicy]:
    """Returns the method of a network that chooses actions, beside the goal recognizer.

    `spec_fields` returns fields of the spec that the configuration gives by other names.
    """

    def complete(source: FitDataset, config: C) -> C:
        if not config.recognizer:
            return config
        ref = active_recognizer(source.data_dir, ModelRef(config.recognizer, config.recognizer_version))
        return replace(config, recognizer_version=ref.version)

    def spec_and_recognizer(source: FitDataset, config: C) -> tuple[S, StoredRecognizer | None]:
        cameras, action = source.cameras(config.cameras), source.dataset.spec.action
        fields, stored = spec_fields(config), None
        if config.recognizer:
            ref = ModelRef(config.recognizer, config.recognizer_version)
            stored = load_recognizer(source.data_dir, ref, cameras=cameras)
            fields |= stored.spec_fields
        return spec_of(config, spec_class, cameras=cameras, action=action, **fields), stored

    def prepare(source: FitDataset, config: C, device: torch.device) -> GoalImagesLearner[N]:
        training, validation = source.trajectories(config.cameras).split(
            fraction=config.validation_fraction, seed=config.seed, min_length=config.min_goal_steps + 1
        )
        spec, stored = spec_and_recognizer(source, config)
        return learner_class(config, spec, training, validation, source.dataset.fingerprint, device, stored)

    def card(source: FitDataset, learner: GoalImagesLearner[N], fitted: FitResult[N]) -> dict[str, Any]:
        losses = learner.validation_losses(fitted.network)
        threshold, stored = learner.reached_threshold(fitted.network), learner.stored
        figures = {name: loss.item() for name, loss in losses.items() if name != "train_loss"}
        supervision = supervision_of(_SUPERVISION, read_teachers(source.root))
        if stored is not None:
            supervision["supervision"] += f"; those of its goal recognizer: {stored.card.get('supervision')}"
            supervision["privileged"] |= stored.card.get("privileged") is True
        return {
            **ControlSpec(source.dataset.spec.control_dt_s, threshold, learner.max_steps_per_goal).to_card(),
            "figures": fitted.figures | figures,
            **supervision,
            **({} if stored is None else {"recognizer": stored.describe()}),
        }

    load = loader(GoalImagesPolicy, spec_class, network_class)
    return Method(config_class, spec_and_recognizer, prepare, card, load, complete=complete)
