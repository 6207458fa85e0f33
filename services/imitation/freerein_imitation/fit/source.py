"""What a fit learns from, whatever the kind of policy."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freerein.data import Dataset, dataset_path
from freerein.data.lookup import open_dataset
from freerein_imitation.training.exploration import Exploration


@dataclass(frozen=True, eq=False)
class Source:
    """What is learned from.

    Attributes:
        root: The dataset's folder.
        dataset: It, opened.
    """

    root: Path
    dataset: Dataset


def open_source(data_dir: Path, name: str) -> Source:
    """Returns the dataset of a name.

    Raises:
        NotFound: There is none.
        InvalidInput: It cannot be learned from.
    """
    return Source(dataset_path(data_dir, name), open_dataset(data_dir, name))


def timestep(dataset: Dataset, camera: str) -> Exploration:
    """Returns one timestep of the sizes of a dataset's: enough for a design to refuse what there is no network for."""
    spec = dataset.spec
    frame, action = np.zeros((1, *spec.cameras[camera]), np.uint8), np.zeros((1, spec.action.size), np.float32)
    return Exploration([frame], [action])
