"""Datasets to learn from, as a request names them."""

from collections.abc import Sequence
from pathlib import Path

from freerein.data.layout import dataset_path
from freerein.data.reader import Dataset
from freerein.errors import InvalidInput, NotFound, must_be, quoted
from freerein.types.common import is_name


def open_dataset(data_dir: Path, name: str) -> Dataset:
    """Opens a dataset of the data directory. Raises NotFound when there is none of that name."""
    path = dataset_path(data_dir, name)
    if not path.is_dir():
        raise NotFound(
            f"The dataset must be in the data directory; got {quoted(name)}.",
            field="dataset",
            hint="Record one: freerein sim demonstrate TASK --out NAME. If you did, start commands and services in one "
            "folder, or give them one FREEREIN_DATA_DIR.",
        )
    return Dataset(path)


def dataset_names(data_dir: Path) -> list[str]:
    """Returns the names of the datasets of the data directory, sorted."""
    found = (path.parent.name for path in (data_dir / "datasets").glob("*/meta"))
    return sorted(name for name in found if is_name(name))


def choose_cameras(dataset: Dataset, asked: Sequence[str]) -> tuple[str, ...]:
    """Returns the cameras to learn from: those asked for, else the dataset's first.

    Raises:
        InvalidInput: The dataset has no camera of one of the names, or one is named twice.
    """
    cameras = tuple(dataset.spec.cameras)
    chosen = tuple(asked) or cameras[:1]
    if len(set(chosen)) != len(chosen) or not set(chosen) <= set(cameras):
        rule = f"among the dataset's, {', '.join(cameras)}, each once"
        hint = f"For example: --set cameras={cameras[0]}."
        raise must_be("`cameras`", rule, "others, or one twice", field="config.cameras", hint=hint)
    return chosen


def unseen_cameras(cameras: Sequence[str], chosen: Sequence[str]) -> str:
    """Returns a sentence about a dataset's cameras that are not among those to learn from; empty where all are."""
    unseen = [each for each in cameras if each not in chosen]
    if not unseen:
        return ""
    return (
        f"Of the cameras {', '.join(cameras)}, the model sees {' and '.join(chosen)}; another is chosen by "
        f"--set cameras={unseen[0]}."
    )


def choose_camera(dataset: Dataset, asked: str, *, of_model: str, field: str = "camera") -> str:
    """Returns the camera whose frames a model is to label: the one asked for, else the model's, else the only one.

    Raises:
        InvalidInput: The dataset has no camera of that name, or it has several cameras, none of them the model's, and
            none was asked for.
    """
    cameras = tuple(dataset.spec.cameras)
    chosen = asked or (cameras[0] if len(cameras) == 1 else of_model)
    if chosen not in cameras:
        raise InvalidInput(
            f"The camera must be one of the dataset's, {', '.join(cameras)}; "
            f"{'another was asked for' if asked else 'the model was fitted on another'}.",
            field=field,
            hint=f"Name {'one of these' if asked else 'the one that shows what the model was fitted on'}.",
        )
    return chosen
