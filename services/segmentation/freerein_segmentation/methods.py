"""The service's method: skills of timesteps from the set of skills of each trajectory.

The methods of chapter 2 share one network and one loop, and differ in the objective, which is a choice of the
configuration; see `freerein_segmentation.objectives`.
"""

from collections.abc import Iterator
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from freerein.data import Dataset, tag_problems
from freerein.data.batch_memory import Batches, batch_problems
from freerein.errors import InvalidInput
from freerein.learning.action_scaling import ActionScaling
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.inputs import spec_of
from freerein.learning.methods import Method, Methods
from freerein.learning.training_loop import FitResult
from freerein_segmentation import model
from freerein_segmentation.model import ModelSpec, SegmentationModel, SegmentationNetwork
from freerein_segmentation.training import Confidence, SegmentationConfig, SegmentationLearner

_ENCODER_COST = {"convolutional": 3.2}
"""Memory of an encoder relative to that of `patch`, measured, where it takes more."""


def _check(source: FitDataset, config: SegmentationConfig) -> None:
    _check_tags(source.dataset)
    _check_evidence(source.dataset, config)
    _spec(source, config)  # rejects frames and actions that are out of bounds
    _check_memory(source, config)


def _check_tags(dataset: Dataset) -> None:
    for problem in tag_problems(dataset.spec.skills, dataset.skills):
        if problem.severity == "error":
            raise InvalidInput(problem.sentence, field="dataset", hint=problem.hint)


def _check_evidence(dataset: Dataset, config: SegmentationConfig) -> None:
    if config.action_evidence and not dataset.spec.has_actions:
        raise InvalidInput(
            f"`action_evidence` must be 0 for a dataset without actions; got {config.action_evidence:g}.",
            field="config.action_evidence",
            hint="Record the executed actions, or leave it out.",
        )


def _check_memory(source: FitDataset, config: SegmentationConfig) -> None:
    """Raises InvalidInput where a batch of the longest trajectories takes too much memory."""
    (camera,) = source.cameras(config.cameras)
    frame, cost = (camera.height, camera.width, camera.channels), _ENCODER_COST.get(config.encoder, 1.0)
    batches = Batches(source.dataset.lengths, frame, config.batch_size, config.stride, cost)
    for problem in batch_problems(batches, dataset=source.root.name):
        raise InvalidInput(problem.sentence, field="config.batch_size", hint=problem.hint)


def _prepare(source: FitDataset, config: SegmentationConfig, device: torch.device) -> SegmentationLearner:
    _check_tags(source.dataset)  # trajectories may have been added while the fit was queued
    training, validation = source.trajectories(config.cameras, any_unit=True).split(
        fraction=config.validation_fraction, seed=config.seed
    )
    scaling = None
    if config.use_actions and not source.dataset.spec.has_scaled_actions and not source.dataset.spec.action.choices:
        scaling = ActionScaling.of(np.concatenate([training.actions[item] for item in range(len(training))]))
    spec = _spec(source, config, action_scaling=scaling)
    return SegmentationLearner(config, spec, training, validation, source.dataset.fingerprint, device)


def _spec(source: FitDataset, config: SegmentationConfig, *, action_scaling: ActionScaling | None = None) -> ModelSpec:
    spec, cameras = source.dataset.spec, source.cameras(config.cameras)
    others = {"skills": spec.skills, "action_scaling": action_scaling, "scores_colours": True}
    return spec_of(config, ModelSpec, cameras=cameras, action=spec.action, **others)


def _card(source: FitDataset, learner: SegmentationLearner, fitted: FitResult[SegmentationNetwork]) -> dict[str, Any]:
    precision = learner.tag_average_precision(fitted.network)
    each = [figures["average_precision"] for figures in precision.values()]
    mean = {"tag_average_precision": float(np.mean(each))} if each else {}
    confidence = learner.confidence(fitted)
    decided = {"confidence": confidence.mean} if confidence.has_choice else {}
    problems = tag_problems(source.dataset.spec.skills, source.dataset.skills)
    return {
        "supervision": "the set of skills of each trajectory",
        "figures": fitted.figures | mean | decided,
        "tag_average_precision": precision,
        "held_out": len(learner.validation),
        "warnings": [*(problem.sentence for problem in problems), *_undecided(confidence)],
    }


def _undecided(confidence: Confidence) -> Iterator[str]:
    """Yields a warning where the network names all tags of a trajectory at every timestep."""
    if not confidence.is_decided:
        yield (
            "Labels must be decided; held-out timesteps of trajectories with several tags have a confidence of "
            f"{confidence.mean:.2f} on average, where all tags at every timestep would have {confidence.equal:.2f}. If "
            "the last frames show what was done, let the network see fewer: --set context=5."
        )


METHODS: Methods[SegmentationModel] = Methods(
    "segmentation",
    MappingProxyType({"set_supervised": Method(SegmentationConfig, _check, _prepare, _card, model.load)}),
)
