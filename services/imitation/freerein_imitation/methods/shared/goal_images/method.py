"""Methods that follow goal images: how a learner is prepared, what the card says, and loading."""

from collections.abc import Callable
from typing import Any, TypeVar

import torch

from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig
from freerein_imitation.methods.shared.goal_images.losses import GoalImagesLearner, N, reached_threshold
from freerein_imitation.methods.shared.goal_images.network import GoalImagesSpec
from freerein_imitation.methods.shared.goal_images.policy import GoalImagesPolicy
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.torch_policy import loader

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

    def check(source: FitDataset, config: C) -> S:
        cameras, action = source.cameras(config.cameras), source.dataset.spec.action
        return spec_of(config, spec_class, cameras=cameras, action=action, **spec_fields(config))

    def prepare(source: FitDataset, config: C, device: torch.device) -> GoalImagesLearner[N]:
        training, validation = source.trajectories(config.cameras).split(
            fraction=config.validation_fraction, seed=config.seed, min_length=config.min_goal_steps + 1
        )
        return learner_class(config, check(source, config), training, validation, source.dataset.fingerprint, device)

    def card(source: FitDataset, learner: GoalImagesLearner[N], fitted: FitResult[N]) -> dict[str, Any]:
        losses = learner.validation_losses(fitted.network)
        threshold = reached_threshold(fitted.network.recognizer, learner.validation)
        figures = {name: losses[name].item() for name in ("action_loss", "recognizer_loss")}
        return {
            **ControlSpec(source.dataset.spec.control_dt_s, threshold, learner.max_steps_per_goal).to_card(),
            "figures": fitted.figures | figures,
            "supervision": "images and executed actions of exploration",
        }

    return Method(config_class, check, prepare, card, loader(GoalImagesPolicy, spec_class, network_class))
