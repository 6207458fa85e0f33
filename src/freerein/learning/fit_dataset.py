"""A dataset as fits use it: its cameras, actions and trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from freerein.data.layout import dataset_path
from freerein.data.lookup import open_dataset
from freerein.data.reader import Dataset
from freerein.learning.trajectories import Trajectories
from freerein.types.common import Camera


@dataclass(frozen=True, eq=False)
class FitDataset:
    """A dataset to fit to.

    Attributes:
        root: Folder of the dataset; models' predictions lie beside the data, such as skill labels.
        dataset: The open dataset.
    """

    root: Path
    dataset: Dataset

    @classmethod
    def open(cls, data_dir: Path, name: str) -> "FitDataset":
        """Returns the dataset of a name; raises as `freerein.data.lookup.open_dataset`."""
        return cls(dataset_path(data_dir, name), open_dataset(data_dir, name))

    def cameras(self, names: Sequence[str]) -> tuple[Camera, ...]:
        """Returns cameras with their frame sizes."""
        return tuple(Camera(name, *self.dataset.spec.cameras[name]) for name in names)

    def trajectories(self, cameras: Sequence[str]) -> Trajectories:
        """Returns the trajectories, with the frames of some cameras.

        Raises:
            InvalidInput: The dataset is empty, or a file is corrupt.
            FailedPrecondition: The disk is too small for the decoded frames.
        """
        return Trajectories(
            frames={camera: self.dataset.cached_frames(camera) for camera in cameras},
            actions=self.dataset.cached_actions(),
            skills=self.dataset.skills if any(self.dataset.skills) else (),
            goal_texts=self.dataset.goal_texts if any(self.dataset.goal_texts) else (),
        )
