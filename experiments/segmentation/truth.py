"""True skill labels of a dataset, for evaluation and for the supervised ceiling."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiments.segmentation.dataset import SplitName, step_cache
from freerein.data.cache import StepCache


def open_labels(folder: Path, name: SplitName) -> StepCache[np.int64]:
    """Returns the true labels of a split, int64 (T,) per trajectory: indices into the world's skills."""
    lengths = np.fromfile(folder / name / "lengths.raw", np.int64)
    return step_cache(folder / "truth" / name / "labels.raw", lengths, np.dtype(np.int64), ())


def first_labels(folder: Path, name: SplitName, count: int) -> list[npt.NDArray[np.int64]]:
    """Returns the true labels of the first `count` trajectories of a split, int64 (T,) each."""
    labels = open_labels(folder, name)
    return [labels[index] for index in range(count)]
