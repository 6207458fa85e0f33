"""Models in frames that no other arm shows them, and whether the in-distribution score tells where they fail.

These are effects on nominal frames beyond the conditions of the worlds and, for rewards, distractors. Some cost a model
nothing, and others nearly all: a score is worth as much as it tells these from those.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from experiments.robustness import confidence, scenes, segmentation
from experiments.robustness.confidence import Answers
from experiments.robustness.draw import Drawn, Scenes, open_or_draw
from experiments.robustness.worlds import BLOCKS, DISTRACTORS, NOMINAL
from experiments.segmentation.evaluation import FRAME_ACCURACY
from experiments.workbench.results import Outcome, Sample
from freerein.types.segmentation import FLAGGED
from freerein_reward.model import DualEncoderModel
from freerein_segmentation.model import SegmentationModel
from freerein_sim.worlds.camera_effects import turn_hue

METHOD = "unfamiliar"

Frames = npt.NDArray[np.uint8]

WITHIN, HARMLESS, HARMFUL = (f"in_distribution.{name}" for name in ("within", "flagged-harmless", "flagged-harmful"))
"""Figures: the lowest AUROC within a condition in which some answers are wrong; the greatest share of answers that is
flagged where accuracy falls by less than two points; the least one where it is below three quarters."""

_LOST, _MOST_WRONG = 0.02, 0.75
_SPECKS = 0.01
"""Share of the pixels that are black, and of those that are white."""

_LUMA = np.array([0.299, 0.587, 0.114])


def _gray(frames: Frames) -> Frames:
    return np.repeat(np.rint(frames @ _LUMA)[..., None], 3, axis=3).astype(np.uint8)


def _gamma(frames: Frames, *, exponent: float) -> Frames:
    return np.rint(255 * (frames / 255) ** exponent).astype(np.uint8)


def _specks(frames: Frames) -> Frames:
    drawn = np.random.default_rng(0).random(frames.shape[:3])
    seen = frames.copy()
    seen[drawn < _SPECKS], seen[drawn > 1 - _SPECKS] = 0, 255
    return seen


def _hue(frames: Frames, *, by: float, light: float = 1.0) -> Frames:
    lit = np.clip(np.rint(light * frames), 0, 255).astype(np.uint8)
    return np.stack([turn_hue(frame, by=by) for frame in lit])


EFFECTS: Mapping[str, Callable[[Frames], Frames]] = MappingProxyType(
    {
        "gray": _gray,
        "gamma-0.6": partial(_gamma, exponent=0.6),
        "gamma-1.6": partial(_gamma, exponent=1.6),
        "salt-and-pepper": _specks,
        "hue-plus-15": partial(_hue, by=0.15),
        "hue-plus-10, light-1.4": partial(_hue, by=0.1, light=1.4),
        "black": np.zeros_like,
        "upside-down": lambda frames: frames[:, ::-1].copy(),
        "inverted": lambda frames: 255 - frames,
    }
)
"""Effects on frames, uint8 (N, H, W, 3), by name."""


def scene_specs() -> dict[tuple[str, str], Scenes]:
    """Returns the scenes by condition and number of blocks, those with distractors among them."""
    nominal = {blocks: spec for (condition, blocks), spec in scenes.scene_specs().items() if condition == NOMINAL}
    distracted = {
        (name, blocks): replace(spec, condition=name) for name in DISTRACTORS for blocks, spec in nominal.items()
    }
    return scenes.scene_specs() | distracted


def evaluate_segmentation(model: SegmentationModel, work: Path) -> Outcome:
    """Returns frame accuracies and figures of the in-distribution score under all conditions and effects."""
    drawn = {name: open_or_draw(spec, work) for name, spec in segmentation.test_specs().items()}
    answers = {name: segmentation.answers(model, each) for name, each in _with_effects(drawn)}
    accuracies = {f"{name}.{FRAME_ACCURACY}": _accuracy(each) for name, each in answers.items()}
    return Outcome({}, {**accuracies, **score_figures(answers)})


def evaluate_reward(model: DualEncoderModel, work: Path) -> Outcome:
    """Returns accuracies and rewards of absent blocks by condition, and figures of the score."""
    answers: dict[str, list[Answers]] = {}
    samples: dict[str, Sample] = {}
    for blocks in BLOCKS:
        drawn = {name: open_or_draw(spec, work) for (name, count), spec in scene_specs().items() if count == blocks}
        for name, each in _with_effects(drawn):
            judged, answered = scenes.judge(model, each)
            answers.setdefault(name, []).append(answered)
            scored = scenes.score(judged, scenes.truth_of(each), each.seen["lengths"])
            samples |= {f"{name}.{blocks}.{figure}": sample for figure, sample in scored}
    return Outcome({}, {**samples, **score_figures({name: confidence.pool(each) for name, each in answers.items()})})


def _with_effects(drawn: Mapping[str, Drawn]) -> Iterator[tuple[str, Drawn]]:
    """Yields what was drawn under each condition, then nominal frames with each effect."""
    yield from drawn.items()
    nominal = drawn[NOMINAL]
    for name, effect in EFFECTS.items():
        yield name, replace(nominal, seen={**nominal.seen, "frames": effect(nominal.seen["frames"])})


def _accuracy(answers: Answers) -> Sample:
    return confidence.by_trial(answers.right, np.ones(len(answers.right)), answers.trial)


def score_figures(answers: Mapping[str, Answers]) -> dict[str, Sample]:
    """Returns figures over all conditions, and the worst of single ones, of answers by condition."""
    accuracy = {name: each.right.mean() for name, each in answers.items()}
    flagged = {
        name: confidence.by_trial(each.score < FLAGGED, np.ones(len(each.score)), each.trial)
        for name, each in answers.items()
    }
    within = [
        confidence.auroc(each.score, each.right, each.trial) for name, each in answers.items() if 0 < accuracy[name] < 1
    ]
    harmless = [flagged[name] for name in answers if accuracy[name] > accuracy[NOMINAL] - _LOST]
    harmful = [flagged[name] for name in answers if accuracy[name] < _MOST_WRONG]
    return {
        **confidence.samples(confidence.pool(answers.values()), nominal=answers[NOMINAL]),
        WITHIN: min(within, key=lambda sample: sample.mean),
        HARMLESS: max(harmless, key=lambda sample: sample.mean),
        HARMFUL: min(harmful, key=lambda sample: sample.mean),
        **{f"{name}.{confidence.FLAGGED_SHARE}": each for name, each in flagged.items()},
    }
