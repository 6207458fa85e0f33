"""Baselines without a network. They know the true labels' lengths, their skills, the longest one, or the order."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

from freerein import metrics

Labels = npt.NDArray[np.int64]

TRUTH = "truth"
"""Not a baseline: its results hold the true labels."""


class Guess(Protocol):
    """A baseline without a network."""

    def __call__(self, truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
        """Returns labels of a trajectory, int64 (T,), given the true ones, the number of skills and a generator."""


def guess_skill(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns a random skill for each timestep: the dissertation's Random."""
    return rng.integers(skills, size=len(truth))


def guess_tag(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns a random one of the trajectory's skills for each timestep: the dissertation's Random-Cls."""
    return rng.choice(np.unique(truth), size=len(truth))


def guess_majority(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns the trajectory's longest skill for all timesteps."""
    return np.full(len(truth), np.bincount(truth).argmax())


def split_in_half(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns the first skill for the first half and the last skill for the second: for trajectories of two skills."""
    half = (len(truth) + 1) // 2
    return np.repeat(truth[[0, -1]], [half, len(truth) - half])


def split_equally(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns the true skills in their true order, each for an equal part of the time."""
    return in_equal_parts(truth)


def tell_truth(truth: Labels, *, skills: int, rng: np.random.Generator) -> Labels:
    """Returns the true labels, which results of other labels are compared with later."""
    return truth


def in_equal_parts(labels: Labels) -> Labels:
    """Returns the skills of labels (T,) in their order, each for an equal part of the time."""
    order = labels[metrics.run_starts(labels)]
    return order[np.arange(len(labels)) * len(order) // len(labels)]


GUESSES: Mapping[str, Guess] = MappingProxyType(
    {
        "random": guess_skill,
        "random_cls": guess_tag,
        "majority": guess_majority,
        "fixed_split": split_in_half,
        "equal_parts": split_equally,
        TRUTH: tell_truth,
    }
)
"""Baselines by name."""
