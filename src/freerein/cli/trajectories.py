"""The trajectories of a dataset that a user names."""

from pathlib import Path

from freerein.cli.settings import CliSettings
from freerein.data import Dataset, dataset_path
from freerein.errors import InvalidInput, NotFound
from freerein.types.common import Trajectory


def root_of(dataset: str) -> Path:
    """Returns the folder of a dataset in the data directory, whether or not there is one."""
    return dataset_path(CliSettings().data_dir, dataset)


def trajectory(dataset: Dataset, index: int) -> Trajectory:
    """Returns one trajectory.

    Raises:
        NotFound: There are not so many.
    """
    if index >= len(dataset):
        raise NotFound(
            f"The dataset holds {len(dataset)} trajectories, counted from 0; got {index}.",
            field="index",
            hint="`freerein dataset inspect` says what it holds.",
        )
    return dataset[index]


def choose_camera(dataset: Dataset, camera: str) -> str:
    """Returns the camera that is meant, the first one when none is named.

    Raises:
        InvalidInput: There is none of that name.
    """
    cameras = tuple(dataset.spec.cameras)
    if camera and camera not in cameras:
        raise InvalidInput(
            f"The camera must be one of {', '.join(cameras)}; got another name.",
            field="camera",
            hint="Leave it out for the first.",
        )
    return camera or cameras[0]
