"""What the fits of all methods share: the dataset, its sizes, and the common part of a card."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from freerein.data import Dataset, dataset_path, lookup
from freerein.learning.checkpoints import JSON
from freerein.learning.fit import FitResult
from freerein.learning.fit_config import FitConfig
from freerein_imitation.model.policy import ControlSpec, PolicyNetworkSpec
from freerein_imitation.training.trajectories import TrajectoryDataset


@dataclass(frozen=True, eq=False)
class FitDataset:
    """A dataset to fit to.

    Attributes:
        root: Folder of the dataset.
        dataset: The open dataset.
    """

    root: Path
    dataset: Dataset

    def sizes(self, camera: str) -> PolicyNetworkSpec:
        """Returns the frame and action sizes of the dataset.

        Raises:
            InvalidInput: No network takes frames or actions of these sizes.
        """
        spec = self.dataset.spec
        height, width, channels = spec.cameras[camera]
        return PolicyNetworkSpec(
            camera=camera,
            action_size=spec.action.size,
            action_choices=spec.action.choices,
            height=height,
            width=width,
            channels=channels,
        )

    def trajectories(self, camera: str) -> TrajectoryDataset:
        """Returns the frames of a camera and the executed actions."""
        return TrajectoryDataset(self.dataset.cached_frames(camera), self.dataset.cached_actions())

    def control(self, *, reached_threshold: float, max_steps_per_goal: int) -> dict[str, JSON]:
        """Returns the control spec of a policy for the dataset's actions, as a card's entry."""
        spec = self.dataset.spec
        return ControlSpec(spec.action, 1 / spec.fps, reached_threshold, max_steps_per_goal).to_card()


def open_dataset(data_dir: Path, name: str) -> FitDataset:
    """Returns the dataset of a name.

    Raises:
        NotFound: There is no such dataset.
        InvalidInput: The dataset is damaged.
    """
    return FitDataset(dataset_path(data_dir, name), lookup.open_dataset(data_dir, name))


def fit_entries(
    source: FitDataset, config: FitConfig, fitted: FitResult[Any], *, fingerprint: str, **figures: float
) -> dict[str, JSON]:
    """Returns a card's entries on the fit: data, configuration and validation figures."""
    figures = {"validation_loss": fitted.validation_loss, "best_step": fitted.best_step, **figures}
    return {
        "task": source.dataset.spec.task,
        "data": {"trajectories": len(source.dataset), "fingerprint": fingerprint},
        "config": asdict(config),
        "figures": dict(figures),
    }
