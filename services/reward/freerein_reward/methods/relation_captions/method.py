"""The method `relation_captions`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.errors import InvalidInput
from freerein.goal_text import MAX_UNKNOWN_CHARACTERS, bare_words, rival_captions, words
from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein.learning.split import train_validation_split
from freerein_reward.methods.relation_captions.caption_checks import accuracy_warnings, caption_warnings, check_shown
from freerein_reward.methods.relation_captions.caption_dataset import caption_images
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.relation_captions.evaluation import evaluate_reward
from freerein_reward.methods.relation_captions.losses import RewardModelLearner, network_spec
from freerein_reward.model import KNOWN, DualEncoder, GradCamModel, load_grounding, load_reward_model

_MAX_PHRASES = 16  # captions grow with the square, and the memory of their embeddings with the fourth power


def _check(_source: FitDataset, config: RewardConfig, *, grounding: Path) -> None:
    distinct = {bare_words(words(phrase)) for phrase in config.phrases} - {()}
    if not 2 <= len(config.phrases) == len(distinct) <= _MAX_PHRASES or any(map(rival_captions, config.phrases)):
        raise InvalidInput(
            f"`phrases` must be 2 to {_MAX_PHRASES} distinct noun phrases without relations such as `on`; "
            f"got {len(config.phrases)}.",
            field="config.phrases",
            hint="Name every object of the goal texts, "
            'for example: --set \'phrases=["a red block", "a yellow block"]\'.',
        )
    _check_known(config.phrases, load_grounding(grounding, "cpu"))


def _check_known(phrases: Sequence[str], model: GradCamModel) -> None:
    """Raises InvalidInput where a grounding model does not know a phrase; captions would name something else."""
    known = zip(phrases, model.known(phrases), strict=True)
    unknown = [phrase[:MAX_UNKNOWN_CHARACTERS] for phrase, score in known if score < KNOWN]
    if unknown:
        raise InvalidInput(
            f"`phrases` must name what the grounding model knows; it does not know {', '.join(unknown)}.",
            field="config.phrases",
            hint=f"Name each object by a colour and a noun, such as `a {model.names[0]} thing`; it knows "
            f"{', '.join(model.names)}."
            if model.names
            else "Train another grounding model.",
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
    spec = network_spec(model.network.spec, config)  # rejects what is out of bounds before captioning
    images = caption_images(dataset, model, config, captions / f"captions-{grounding.name}.safetensors")
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
