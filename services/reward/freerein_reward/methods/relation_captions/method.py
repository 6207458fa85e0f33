"""The method `relation_captions`."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.errors import InvalidInput
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein.learning.split import train_validation_split
from freerein.learning.training_loop import FitResult
from freerein_reward.methods.relation_captions.caption_checks import accuracy_warnings, caption_warnings
from freerein_reward.methods.relation_captions.caption_dataset import caption_images
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.evaluation import evaluate_reward
from freerein_reward.methods.relation_captions.losses import RewardModelLearner, network_spec
from freerein_reward.methods.shared.phrases import check_phrases, check_shown
from freerein_reward.model import (
    DualEncoder,
    DualEncoderSpec,
    GradCamModel,
    PhraseLocator,
    load_grounding,
    load_reward_model,
)


def _check(_source: FitDataset, config: RewardConfig, *, grounding: Path) -> None:
    model = load_grounding(grounding, "cpu")
    _check_initial(config, model)
    check_phrases(config.phrases, model, least=2)


def _check_initial(config: RewardConfig, model: PhraseLocator) -> None:
    if config.initial == "grounding" and not isinstance(model, GradCamModel):
        raise InvalidInput(
            "`initial` must be scratch with a grounding model that was trained elsewhere: its weights fit no reward "
            f"model; got {config.initial}.",
            field="config.initial",
            hint="Add --set initial=scratch --set distillation=10.",
        )


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
    dataset, model = source.dataset, load_grounding(grounding, str(device))
    spec = network_spec(_base_spec(model), config)  # rejects what is out of bounds before captioning
    shapes = [dataset.spec.cameras[camera] for camera in config.cameras]
    spec = replace(spec, aspects=tuple(height / width for height, width, _ in shapes))
    cache = captions / f"captions-{grounding.name}.safetensors"
    images = caption_images(dataset, model, config, cache, size=spec.image_size)
    check_shown(dataset.cached_frames(config.cameras[0]).steps, config.phrases, model)
    training, validation = images.split(dataset.lengths, fraction=config.validation_fraction, seed=config.seed)
    _, held_out = train_validation_split(np.arange(len(dataset)), fraction=config.validation_fraction, seed=config.seed)
    fingerprint = f"{dataset.fingerprint} {grounding.name}"
    return RewardModelLearner(
        config, spec, training, validation, model, grounding.name, fingerprint, device, len(held_out)
    )


def _base_spec(model: PhraseLocator) -> DualEncoderSpec:
    """Returns the sizes of a reward model: those of the grounding model, or the defaults."""
    return model.network.spec if isinstance(model, GradCamModel) else DualEncoderSpec(cameras=("",), vocabulary=("a",))


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
