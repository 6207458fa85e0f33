"""Segmentation of the demonstrations: a fit from tags, guesses, and frame accuracy under each condition."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from experiments.robustness.confidence import Answers
from experiments.robustness.draw import Demonstrations, Drawn, dataset_path, open_or_draw
from experiments.robustness.fits import fit_once
from experiments.robustness.worlds import CAMERA, conditions
from experiments.segmentation.evaluation import FRAME_ACCURACY
from experiments.workbench.results import Outcome, Sample
from freerein.learning.inputs import spec_of
from freerein.learning.trajectories import Trajectories
from freerein.types.segmentation import SegmentRequest
from freerein_segmentation.core.decoding import Decoded, decode
from freerein_segmentation.model import ModelSpec, SegmentationModel, load
from freerein_segmentation.training import SegmentationConfig, SegmentationLearner
from freerein_sim.worlds.tasks import tasks

Guess = Callable[..., npt.NDArray[np.int64]]

TRAINING = Demonstrations(count=400, seed=1, least_skills=2, most_skills=3)
SETTINGS = {"cameras": [CAMERA], "stride": 3}
_TEST_COUNT, _TEST_SEED = 40, 1_000_001


def test_specs() -> dict[str, Demonstrations]:
    """Returns the held-out demonstrations by condition: of all skills, where blocks are fewer of theirs."""
    all_skills = len(tasks()[TRAINING.task].spec.skills)
    skills = {"blocks-2": 2, "blocks-3": 3}
    return {
        condition: Demonstrations(
            _TEST_COUNT, _TEST_SEED, skills.get(condition, all_skills), skills.get(condition, all_skills), condition
        )
        for condition in conditions(TRAINING.task)
    }


def fit_config(*, augmentation: float, seed: int) -> SegmentationConfig:
    """Returns the service's configuration of a fit."""
    return SegmentationConfig.from_mapping({**SETTINGS, "augmentation": augmentation, "seed": seed})


def fit_model(config: SegmentationConfig, work: Path, on_progress: Callable[[], None]) -> SegmentationModel | None:
    """Returns the fitted model; None when the fit was stopped."""

    def make_learner() -> SegmentationLearner:
        spec, drawn = tasks()[TRAINING.task].spec, open_or_draw(TRAINING, work)
        training, validation = _trajectories(drawn, spec.skills).split(
            fraction=config.validation_fraction, seed=config.seed
        )
        cameras = tuple(camera for camera in spec.cameras if camera.name == CAMERA)
        network = spec_of(
            config, ModelSpec, cameras=cameras, action=spec.action, skills=spec.skills, scores_colours=True
        )
        return SegmentationLearner(config, network, training, validation, data, torch.device("cpu"))

    data = dataset_path(TRAINING, work).name
    folder = fit_once(config, [data], make_learner, work=work, on_progress=on_progress)
    return None if folder is None else load(folder, "cpu")


def evaluate(model: SegmentationModel, work: Path) -> Outcome:
    """Returns frame accuracies after the service's decoding."""
    samples = {}
    for condition, spec in test_specs().items():
        answered = answers(model, open_or_draw(spec, work))
        right = np.split(answered.right, np.flatnonzero(np.diff(answered.trial)) + 1)
        samples[f"{condition}.{FRAME_ACCURACY}"] = Sample.of_flags(right)
    return Outcome({}, samples)


def answers(model: SegmentationModel, drawn: Drawn) -> Answers:
    """Returns the answers of a model after the service's decoding, one for each timestep."""
    labels = drawn.by_trajectory("labels")
    pairs = zip(drawn.by_trajectory("frames"), drawn.by_trajectory("actions"), strict=True)
    predictions = [model.predict(*pair) for pair in pairs]
    decoded = [_decode(each.probabilities, model.skills) for each in predictions]
    return Answers(
        right=np.concatenate([each.labels == truth for each, truth in zip(decoded, labels, strict=True)]),
        confidence=np.concatenate([each.confidence for each in decoded]),
        score=np.concatenate([each.in_distribution for each in predictions]),
        trial=np.repeat(np.arange(len(labels)), [len(each) for each in labels]),
    )


def evaluate_guess(guess: Guess, work: Path) -> Outcome:
    """Returns frame accuracies of a guess, which may know the true labels."""
    rng, skills = np.random.default_rng(0), len(tasks()[TRAINING.task].spec.skills)
    samples = {}
    for condition, spec in test_specs().items():
        labels = open_or_draw(spec, work).by_trajectory("labels")
        right = [guess(each, skills=skills, rng=rng) == each for each in labels]
        samples[f"{condition}.{FRAME_ACCURACY}"] = Sample.of_flags(right)
    return Outcome({}, samples)


def _decode(probabilities: npt.NDArray[np.float32], skills: tuple[str, ...]) -> Decoded:
    defaults = SegmentRequest()
    return decode(
        probabilities,
        skills=skills,
        smoothing=defaults.smoothing,
        min_segment=defaults.min_segment,
        min_kept=defaults.min_kept,
        min_confidence=defaults.min_confidence,
    )


def _trajectories(drawn: Drawn, skills: tuple[str, ...]) -> Trajectories:
    tags = [tuple(skill for skill, used in zip(skills, row, strict=True) if used) for row in drawn.seen["tags"]]
    return Trajectories({CAMERA: drawn.by_trajectory("frames")}, drawn.by_trajectory("actions"), skills=tags)
