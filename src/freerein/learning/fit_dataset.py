"""A dataset as fits use it: its cameras, actions and trajectories."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freerein.data import reached
from freerein.data.layout import dataset_path
from freerein.data.lookup import open_dataset
from freerein.data.reader import Dataset
from freerein.errors import InvalidInput
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

    @property
    def data_dir(self) -> Path:
        """The data directory, where models lie beside datasets."""
        return self.root.parents[1]

    def cameras(self, names: Sequence[str]) -> tuple[Camera, ...]:
        """Returns cameras with their frame sizes."""
        return tuple(Camera(name, *self.dataset.spec.cameras[name]) for name in names)

    def trajectories(self, cameras: Sequence[str], *, any_unit: bool = False) -> Trajectories:
        """Returns the trajectories, with the frames of some cameras.

        Args:
            cameras: Names of the cameras.
            any_unit: Whether continuous actions may be in the robot's own unit; otherwise they must be in [-1, 1].

        Raises:
            InvalidInput: The dataset or a trajectory is empty, a file is corrupt, or actions are not finite or not in
                [-1, 1].
            FailedPrecondition: The disk is too small for the decoded frames.
        """
        self._check_lengths()
        self._check_actions(any_unit=any_unit)
        return Trajectories(
            frames={camera: self.dataset.cached_frames(camera) for camera in cameras},
            actions=self.dataset.cached_actions(),
            skills=self.dataset.skills if any(self.dataset.skills) else (),
            goal_texts=self.dataset.goal_texts if any(self.dataset.goal_texts) else (),
            reached=reached.read(self.root, self.dataset.lengths),
            terminated=self.dataset.cached_terminations() or (),
        )

    def _check_lengths(self) -> None:
        """Raises InvalidInput for trajectories without a timestep, which `freerein dataset check` calls an error."""
        empty = np.flatnonzero(self.dataset.lengths == 0)
        if len(empty):
            raise InvalidInput(
                f"A trajectory must have at least one timestep; {len(empty)} have none, such as {empty[0]}.",
                field="dataset",
                hint="Leave them out.",
            )

    def _check_actions(self, *, any_unit: bool) -> None:
        """Raises InvalidInput for actions that `freerein dataset check` calls an error, or in an unexpected unit."""
        spec = self.dataset.spec
        steps, (low, high) = self.dataset.cached_actions().steps, spec.action_bounds
        outside = int(np.sum(~((steps >= low) & (steps <= high))))
        if outside:
            raise InvalidInput(
                f"Actions must be {spec.action_range}; {outside} of {steps.size} numbers are not.",
                field="dataset",
                hint="Run `freerein dataset check NAME` to see which trajectories, and leave those out.",
            )
        low, high = spec.action.bounds
        if not any_unit and not np.all((steps >= low) & (steps <= high)):
            raise InvalidInput(
                f"This fit needs actions in [{low:g}, {high:g}]; those of the dataset are in a unit of their own.",
                field="dataset",
                hint="Scale them before recording. Segmentation takes actions in any unit.",
            )
