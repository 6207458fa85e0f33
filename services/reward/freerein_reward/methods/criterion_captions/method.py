"""The method `criterion_captions`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.criteria import View
from freerein.errors import InvalidInput, must_be, quoted
from freerein.goal_text import words
from freerein.learning import model_files, tensor_files
from freerein.learning.actor_critic.object_encoder import PHRASES_FILE
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method
from freerein.learning.split import train_validation_split
from freerein.learning.training_loop import FitResult
from freerein_reward.methods.criterion_captions.config import CriterionConfig
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel
from freerein_reward.methods.criterion_captions.evaluation import evaluate_criteria
from freerein_reward.methods.criterion_captions.keypoint_dataset import ViewLayout, locate_phrases, view_layout
from freerein_reward.methods.criterion_captions.losses import CriterionLearner
from freerein_reward.methods.criterion_captions.network import CriterionNetwork
from freerein_reward.methods.criterion_captions.spec import NO_CAMERA, CriterionSpec, check_views
from freerein_reward.methods.shared.phrases import check_phrases, check_shown
from freerein_reward.model import GradCamModel, load_built_in

_CHANCE = 0.6
"""Balanced accuracy up to which a criterion counts as not learned."""


def _complete(_source: FitDataset, config: CriterionConfig) -> CriterionConfig:
    return replace(config, views=_views(config))


def _views(config: CriterionConfig) -> tuple[str, ...]:
    """Returns the camera of each view; by default `cameras` in order."""
    return config.views or (*config.cameras, *[NO_CAMERA] * (len(View) - len(config.cameras)))


def _check(source: FitDataset, config: CriterionConfig, *, grounding: Path) -> None:
    check_views(config.cameras, _views(config))
    _check_widths(config.object_widths, _views(config))
    shapes = {(each.height, each.width) for each in source.cameras(config.cameras)}
    if len({height / width for height, width in shapes}) > 1:
        raise InvalidInput(
            f"Frames of all cameras must have one aspect ratio; got {len(shapes)} sizes.",
            field="config.cameras",
            hint="Scale the frames alike when they are imported or recorded.",
        )
    check_phrases(config.phrases, load_built_in(grounding, "cpu"), least=2)


def _check_widths(widths: Sequence[float], views: Sequence[str]) -> None:
    if len(widths) not in (1, len(View)) or not all(0.001 <= each <= 0.5 for each in widths):
        raise InvalidInput(
            f"`object_widths` must be one number, or one for each of {len(View)} views, in [0.001, 0.5]; "
            f"got {len(widths)} from {min(widths, default=0):g} to {max(widths, default=0):g}.",
            field="config.object_widths",
            hint="Measure an object in a frame: its width in pixels over the frame's.",
        )
    different = set(zip(views, widths, strict=False))
    if twice := next((view for view in views if view and sum(view == each for each, _ in different) > 1), ""):
        got = " and ".join(f"{width:g}" for view, width in sorted(different) if view == twice)
        rule, hint = f"the same in all views of {quoted(twice)}", "Give one number for each camera's frames."
        raise must_be("`object_widths`", rule, got, field="config.object_widths", hint=hint)


def _prepare(
    source: FitDataset, config: CriterionConfig, device: torch.device, *, grounding: Path, captions: Path
) -> CriterionLearner:
    """Returns the learner of a fit.

    Args:
        source: Dataset.
        config: Resolved configuration.
        device: Device of the networks.
        grounding: Folder of a version of the grounding model, named after it.
        captions: Folder of the fit, where keypoints are cached and progress is logged.
    """
    dataset, model = source.dataset, load_built_in(grounding, str(device))
    (height, width), *_ = ((each.height, each.width) for each in source.cameras(config.cameras))
    layout = view_layout(
        config.cameras,
        config.views,
        config.object_widths,
        height / width,
        depth=config.object_depth,
        container_width=config.container_width,
    )
    spec = network_spec(model, config, layout)  # rejects what is out of bounds before captioning
    moments = locate_phrases(dataset, model, config, layout, captions / f"places-{grounding.name}.safetensors")
    check_shown(moments.frames[0], config.phrases, model)
    training, validation = moments.split(dataset.lengths, fraction=config.validation_fraction, seed=config.seed)
    _, held_out = train_validation_split(np.arange(len(dataset)), fraction=config.validation_fraction, seed=config.seed)
    fingerprint = f"{dataset.fingerprint} {grounding.name}"
    return CriterionLearner(
        config, spec, training, validation, model, grounding.name, fingerprint, device, len(held_out)
    )


def network_spec(grounding: GradCamModel, config: CriterionConfig, layout: ViewLayout) -> CriterionSpec:
    """Returns the architecture of a model; other phrases are the nouns of the fit in each known colour."""
    units = tuple(float(part) for camera in range(len(config.cameras)) for part in layout.unit(camera))
    theirs = grounding.network.spec
    nouns = dict.fromkeys(words(phrase)[-1] for phrase in config.phrases)
    named = [f"a {name} {noun}" for noun in nouns for name in grounding.names]
    return CriterionSpec(
        cameras=config.cameras,
        views=config.views,
        phrases=config.phrases,
        other_phrases=tuple(each for each in named if each not in config.phrases),
        vocabulary=theirs.vocabulary,
        units=units,
        image_size=theirs.image_size,
        width=theirs.width,
        depth=theirs.depth,
        text_width=theirs.text_width,
        text_depth=theirs.text_depth,
        phrase_dim=theirs.embedding_dim,
        hidden_size=config.hidden_size,
        embedding_dim=config.embedding_dim,
    )


def _card(source: FitDataset, learner: CriterionLearner, fitted: FitResult[CriterionNetwork]) -> dict[str, Any]:
    figures = evaluate_criteria(fitted.network, learner.validation, tolerance=learner.config.tolerance)
    return {
        "data": {"trajectories": len(source.dataset), "fingerprint": source.dataset.fingerprint},
        "grounding": learner.grounding_version,
        "criteria": [each.name for each in fitted.network.grammar.criteria],
        "figures": {**fitted.figures, **figures},
        "supervision": "noun phrases; places and captions made from pixels by the grounding model",
        "warnings": list(criterion_warnings(fitted.network, figures)),
    }


def criterion_warnings(network: CriterionNetwork, figures: dict[str, float]) -> list[str]:
    """Returns a warning for each criterion that validation images never decide, or that was not learned."""
    warnings = []
    for criterion in (each for each in network.grammar.criteria if each.nouns <= len(network.spec.phrases)):
        accuracy = figures.get(f"{criterion.name}.balanced_accuracy")
        if accuracy is None:
            warnings.append(
                f"All held-out images say the same of `{criterion.name}`: the model could not be judged on it. Add "
                "images in which it holds and in which it fails."
            )
        elif accuracy <= _CHANCE:
            warnings.append(
                f"On held-out images the model tells `{criterion.name}` with a balanced accuracy of {accuracy:.0%}: it "
                "has not learned it. Add images or steps, and check `object_widths` and `views`."
            )
    return warnings


def _load(folder: Path, device: str) -> CriterionModel:
    return CriterionModel(model_files.load_model(folder, CriterionSpec, CriterionNetwork, device=device))


def _files(learner: CriterionLearner) -> dict[str, bytes]:
    """Returns the embeddings of the phrases, which an object encoder of the model asks for."""
    texts = learner.grounding.vision_language.embed_texts(learner.spec.phrases)
    return {PHRASES_FILE: tensor_files.dump({"phrases": texts.detach().cpu().contiguous()})}


METHOD = Method(CriterionConfig, _check, _prepare, _card, _load, complete=_complete, needs_actions=False, files=_files)
