"""Baselines without a network. They know the true labels' lengths, their skills, the longest one, or the first."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

import numpy as np
import numpy.typing as npt

Labels = npt.NDArray[np.int64]


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


GUESSES: Mapping[str, Guess] = MappingProxyType(
    {
        "random": guess_skill,
        "random_cls": guess_tag,
        "majority": guess_majority,
        "fixed_split": split_in_half,
    }
)
"""Baselines by name."""
