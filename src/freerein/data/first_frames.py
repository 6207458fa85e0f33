"""Whether the first frame gives the tags away: then a learner need not look at what is done, and learns no skills.

A kernel ridge classifier of low-resolution first frames is cross-validated. Its chance level is that of the same
classifier when the tags are dealt out to the trajectories anew (a permutation test).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import PIL.Image

from freerein.metrics import auroc

MOST_TRAJECTORIES = 500
"""Trajectories that the classifier needs at most; its work grows with the square of their number."""

_SIDE = 16
_FOLDS = 5
_RIDGE = 1.0
_PERMUTATIONS = 499
_FEWEST = 2 * _FOLDS
"""Trajectories with a skill, and without it, below which the classifier is not asked."""


@dataclass(frozen=True)
class FirstFrameTest:
    """How well first frames tell whether a skill occurs.

    Attributes:
        auroc: Area under the ROC curve on held-out trajectories; 0.5 is chance.
        p_value: Probability that first frames without any information do as well, over all skills tested; at least
            0.002, one of the permutations.
    """

    skill: str
    auroc: float
    p_value: float


def low_resolution(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Returns a frame (H, W, C) as mean colours of a coarse grid, float32 (D,) in [0, 1]."""
    pixels = PIL.Image.fromarray(frame[..., 0] if frame.shape[-1] == 1 else frame)
    return np.asarray(pixels.resize((_SIDE, _SIDE), PIL.Image.Resampling.BOX), np.float32).ravel() / np.float32(255)


def first_frame_tests(
    features: npt.NDArray[np.float32], tags: Sequence[Sequence[str]], *, rng: np.random.Generator
) -> list[FirstFrameTest]:
    """Returns a test for each skill that enough trajectories have, and enough have not.

    Args:
        features: First frames, float32 (n, D), of at most `MOST_TRAJECTORIES` trajectories.
        tags: Skills of each trajectory.
        rng: Draws folds and permutations.
    """
    skills = sorted({skill for each in tags for skill in each})
    occurs = np.array([[skill in each for skill in skills] for each in tags]).reshape(len(tags), len(skills))  # (n, K)
    counts = occurs.sum(axis=0)
    tested = np.flatnonzero((counts >= _FEWEST) & (len(tags) - counts >= _FEWEST))
    if not len(tested):
        return []
    occurs, folds = occurs[:, tested], rng.permutation(len(tags)) % _FOLDS
    weights = _held_out_weights(features, folds)
    orders = np.stack([np.arange(len(tags)), *(rng.permutation(len(tags)) for _ in range(_PERMUTATIONS))], axis=1)
    dealt = occurs[orders].reshape(len(tags), -1).astype(np.float64)  # (n, (1 + permutations) * K)
    scores = _centred(weights @ dealt, folds)
    agreement = (scores * dealt).sum(axis=0).reshape(-1, len(tested))  # (1 + permutations, K)
    standard = (agreement - agreement.mean(axis=0)) / np.maximum(agreement.std(axis=0), 1e-12)
    best = standard.max(axis=1)  # over the skills: their tests are one family
    return [
        FirstFrameTest(
            skills[skill],
            auroc(scores[:, place], occurs[:, place]),
            float(np.mean(best >= standard[0, place])),
        )
        for place, skill in enumerate(tested)
    ]


def _held_out_weights(features: npt.NDArray[np.float32], folds: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Returns the matrix (n, n) from the tags of all trajectories to the score of each, by those of other folds."""
    kernel = _kernel(features.astype(np.float64))
    weights = np.zeros(kernel.shape)
    for fold in range(_FOLDS):
        held_out, known = np.flatnonzero(folds == fold), np.flatnonzero(folds != fold)
        ridged = kernel[np.ix_(known, known)] + _RIDGE * np.eye(len(known))
        fitted = np.linalg.solve(ridged, kernel[np.ix_(known, held_out)]).T  # (held out, known)
        weights[np.ix_(held_out, known)] = fitted - fitted.mean(axis=1, keepdims=True)  # targets are centred
    return weights


def _kernel(features: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the Gaussian kernel, float64 (n, n), whose width is the median distance."""
    spread = features.std(axis=0)
    scaled = (features - features.mean(axis=0)) / np.maximum(spread, 0.1 * spread.max() + 1e-12)
    squares = (scaled**2).sum(axis=1)
    distances = np.maximum(squares[:, None] + squares - 2 * scaled @ scaled.T, 0)
    kernel: npt.NDArray[np.float64] = np.exp(-distances / max(float(np.median(distances)), 1e-12))
    return kernel


def _centred(scores: npt.NDArray[np.float64], folds: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Returns scores (n, M) less the mean of their fold, for each fold has a classifier of its own."""
    means = np.stack([scores[folds == fold].mean(axis=0) for fold in range(_FOLDS)])  # (folds, M)
    centred: npt.NDArray[np.float64] = scores - means[folds]
    return centred
