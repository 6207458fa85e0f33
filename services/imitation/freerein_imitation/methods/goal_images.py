"""What the methods for goal images share: the learner's preparation, and the card."""

from typing import Any, TypeVar

import torch

from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein_imitation.model.goal_images import GoalImagesNetwork, GoalImagesSpec
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.training.goal_images import GoalImagesConfig, GoalImagesLearner, reached_threshold

N = TypeVar("N", bound=GoalImagesNetwork)
L = TypeVar("L", bound=GoalImagesLearner[Any])


def prepare(
    source: FitDataset, config: GoalImagesConfig, spec: GoalImagesSpec, device: torch.device, learner: type[L]
) -> L:
    """Returns a learner of a network with a spec on the trajectories of a dataset.

    Raises:
        InvalidInput: Fewer than 2 trajectories are long enough.
    """
    training, validation = source.trajectories(config.cameras).split(
        fraction=config.validation_fraction, seed=config.seed, min_length=config.min_goal_steps + 1
    )
    return learner(config, spec, training, validation, source.dataset.fingerprint, device)


def card(
    source: FitDataset, learner: GoalImagesLearner[N], fitted: FitResult[N], *, max_steps_per_goal: int
) -> dict[str, Any]:
    """Returns the card's entries of a fitted network."""
    losses = learner.validation_losses(fitted.network)
    threshold = reached_threshold(fitted.network.recognizer, learner.validation)
    figures = {name: losses[name].item() for name in ("action_loss", "recognizer_loss")}
    return {
        **ControlSpec(1 / source.dataset.spec.fps, threshold, max_steps_per_goal).to_card(),
        "figures": fitted.figures | figures,
        "supervision": "images and executed actions of exploration",
    }
