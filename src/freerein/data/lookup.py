"""Datasets to learn from, as a request names them."""

from pathlib import Path

from freerein.data.layout import dataset_path
from freerein.data.reader import Dataset
from freerein.errors import InvalidInput, NotFound


def open_dataset(data_dir: Path, name: str) -> Dataset:
    """Opens a dataset of the data directory. Raises NotFound when there is none of that name."""
    path = dataset_path(data_dir, name)
    if not path.is_dir():
        raise NotFound(
            "The dataset must be in the data directory; there is none of that name.",
            field="dataset",
            hint="Record one: freerein sim demonstrate TASK --out NAME.",
        )
    return Dataset(path)


def choose_camera(dataset: Dataset, asked: str) -> str:
    """Returns the camera to learn from: the one asked for, or the only one.

    Raises:
        InvalidInput: The dataset has no camera of that name, or several and none was asked for.
    """
    cameras = tuple(dataset.spec.cameras)
    if asked not in (cameras if asked or len(cameras) > 1 else ("",)):
        raise InvalidInput(
            f"`camera` must be one of the dataset's, {', '.join(cameras)}; got {'another' if asked else 'none'}.",
            field="config.camera",
            hint="A model sees one camera.",
        )
    return asked or cameras[0]
