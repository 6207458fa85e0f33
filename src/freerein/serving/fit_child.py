"""What the child process of any fit does around its training: what was asked for, on which data, and how it ended."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from freerein.data import Dataset, dataset_path
from freerein.errors import InvalidInput, NotFound, ServiceError
from freerein.serving.child import end_with_parent
from freerein.serving.fits import HOPELESS

STOPPED = 1


def run(folder: Path, train: Callable[[str, Mapping[str, Any]], bool]) -> int:
    """Runs a fit, or goes on with it, and ends with the process that started it.

    Args:
        folder: Holds `config.json`: what was asked for.
        train: Given the name of the dataset and the configuration, writes the model into `folder / "model"` and returns
            True, or returns False when it was stopped before.

    Returns:
        The process's exit code: 0 for a model, 1 for a fit that was stopped and can go on, 2 for one that cannot
        succeed, for the reason on stderr's last line.
    """
    end_with_parent()
    asked = json.loads((folder / "config.json").read_bytes())
    try:
        return 0 if train(asked["dataset"], asked["config"]) else STOPPED
    except ServiceError as error:
        sys.stderr.write(f"{error.detail} {error.hint}\n")
        return HOPELESS


def open_dataset(data_dir: Path, name: str) -> Dataset:
    """Returns a dataset of the data directory.

    Raises:
        NotFound: There is none of that name.
    """
    path = dataset_path(data_dir, name)
    if not path.is_dir():
        raise NotFound(
            "The dataset must be one of those in the data directory; there is none of that name.",
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
            f"`camera` must name one of the dataset's, {', '.join(cameras)}; got {'another' if asked else 'none'}.",
            field="config.camera",
            hint="A model sees one camera.",
        )
    return asked or cameras[0]
