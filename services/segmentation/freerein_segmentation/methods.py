"""The service's method: skills of timesteps from the set of skills of each trajectory.

The methods of chapter 2 share one network and one loop, and differ in the objective, which is a choice of the
configuration; see `freerein_segmentation.objectives`.
"""

from types import MappingProxyType
from typing import Any

import torch

from freerein.data import Dataset, tag_problems
from freerein.errors import InvalidInput
from freerein.learning.fit import FitResult
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.methods import Method, Methods
from freerein_segmentation import model
from freerein_segmentation.model import ModelSpec, SegmentationModel, SegmentationNetwork
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner, network_spec


def _resolve(source: FitDataset, config: SegmentationConfig) -> SegmentationConfig:
    _check_tags(source.dataset)
    _spec(source, config)  # rejects frames and actions that are out of bounds
    return config


def _check_tags(dataset: Dataset) -> None:
    for problem in tag_problems(dataset.spec.skills, dataset.skills):
        if problem.severity == "error":
            raise InvalidInput(problem.sentence, field="dataset", hint=problem.hint)


def _prepare(source: FitDataset, config: SegmentationConfig, device: torch.device) -> SegmentationLearner:
    _check_tags(source.dataset)  # trajectories may have been added while the fit was queued
    training, validation = source.trajectories(config.cameras).split(
        fraction=config.validation_fraction, seed=config.seed
    )
    return SegmentationLearner(config, _spec(source, config), training, validation, source.dataset.fingerprint, device)


def _spec(source: FitDataset, config: SegmentationConfig) -> ModelSpec:
    spec = source.dataset.spec
    return network_spec(config, cameras=source.cameras(config.cameras), action=spec.action, skills=spec.skills)


def _card(
    _source: FitDataset, _learner: SegmentationLearner, _fitted: FitResult[SegmentationNetwork]
) -> dict[str, Any]:
    return {"supervision": "the set of skills of each trajectory"}


METHODS: Methods[SegmentationModel] = Methods(
    "segmentation",
    MappingProxyType(
        {
            "set_supervised": Method(
                SegmentationConfig, _resolve, _prepare, _card, model.load, calibrate=SegmentationLearner.calibrate
            )
        }
    ),
)
