"""The method `relation_captions`."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein.learning.split import train_validation_split
from freerein_reward.methods.relation_captions.caption_checks import accuracy_warnings, caption_warnings
from freerein_reward.methods.relation_captions.caption_dataset import caption_images
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.evaluation import evaluate_reward
from freerein_reward.methods.relation_captions.losses import RewardModelLearner, network_spec
from freerein_reward.methods.shared.phrases import check_phrases, check_shown
from freerein_reward.model import DualEncoder, load_built_in, load_reward_model


def _check(_source: FitDataset, config: RewardConfig, *, grounding: Path) -> None:
    check_phrases(config.phrases, load_built_in(grounding, "cpu"), least=2)


def _prepare(
    source: FitDataset, config: RewardConfig, device: torch.device, *, grounding: Path, captions: Path
) -> RewardModelLearner:
    """Returns the learner of a fit.

    Args:
        source: Dataset.
        config: Resolved configuration.
        device: Device of the networks.
        grounding: Folder of a version of the grounding model, named after it.
        captions: Folder of the fit, where captions are cached and progress is logged.
    """
    dataset, model = source.dataset, load_built_in(grounding, str(device))
    spec = network_spec(model.network.spec, config)  # rejects what is out of bounds before captioning
    cache = captions / f"captions-{grounding.name}.safetensors"
    images = caption_images(dataset, model, config, cache, size=spec.image_size)
    check_shown(images.views[0], config.phrases, model)
    training, validation = images.split(dataset.lengths, fraction=config.validation_fraction, seed=config.seed)
    _, held_out = train_validation_split(np.arange(len(dataset)), fraction=config.validation_fraction, seed=config.seed)
    fingerprint = f"{dataset.fingerprint} {grounding.name}"
    return RewardModelLearner(
        config, spec, training, validation, model, grounding.name, fingerprint, device, len(held_out)
    )


def _card(source: FitDataset, learner: RewardModelLearner, fitted: FitResult[DualEncoder]) -> dict[str, Any]:
    figures = evaluate_reward(fitted.network, learner.validation)
    return {
        "data": {"trajectories": len(source.dataset), "fingerprint": source.dataset.fingerprint},
        "grounding": learner.grounding_version,
        "figures": {**fitted.figures, **figures},
        "supervision": "noun phrases; captions made from pixels by the grounding model",
        "warnings": [*caption_warnings(learner.training), *accuracy_warnings(figures)],
    }


METHOD = Method(
    RewardConfig,
    _check,
    _prepare,
    _card,
    load_reward_model,
    needs_actions=False,
)
