"""Datasets as commands name them: finds them, and imports them with a progress bar."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from freerein import data
from freerein.cli.output import progress_bar
from freerein.cli.settings import CliSettings
from freerein.data import Dataset, FolderSource, LeRobotSource, Source, dataset_path
from freerein.errors import NotFound, must_be
from freerein.jobs.in_use import check_unused, names_dataset
from freerein.types.common import Trajectory

Replace = Annotated[bool, typer.Option("--replace", help="Replace a dataset of this name, once the new one is whole.")]


def dataset_root(name: str) -> Path:
    """Returns the folder of a dataset in the data directory, whether or not it exists."""
    return dataset_path(CliSettings().data_dir, check_no_path(name))


def replaceable_root(name: str) -> Path:
    """Returns the folder of a dataset; raises FailedPrecondition where a fit or run that has not ended names it."""
    check_unused(CliSettings().data_dir, f"The dataset {name}", names_dataset(name))
    return dataset_root(name)


def check_no_path(name: str) -> str:
    """Returns what may be the name of a dataset; raises InvalidInput for a path."""
    if "/" in name:
        hint = "`freerein dataset list` names all; `freerein dataset import FOLDER NAME` brings a folder."
        raise must_be("A dataset of the data directory", "named", "a path", field="dataset", hint=hint)
    return name


def read_trajectory(dataset: Dataset, index: int) -> Trajectory:
    """Returns a trajectory of a dataset; raises NotFound where the index is out of range."""
    if index >= len(dataset):
        sentence = f"The index must be below {len(dataset)}, the number of trajectories; got {index}."
        raise NotFound(sentence, field="index", hint="`freerein dataset inspect` shows the dataset.")
    return dataset[index]


def recordings(path: Path) -> Source:
    """Returns the trajectories of a folder, as `freerein dataset import` reads it without options."""
    return LeRobotSource(path) if layout_of(path) == "lerobot" else FolderSource(path)


def layout_of(path: Path) -> Literal["folder", "lerobot"]:
    """Returns the layout of a folder of trajectories, by its `meta`."""
    return "lerobot" if (path / "meta").is_dir() else "folder"


@contextmanager
def imported_with_progress(source: Source, name: str, *, replaces: bool, is_shown: bool) -> Iterator[tuple[str, ...]]:
    """Imports trajectories into the data directory, with a bar; yields and raises as `data.imported`."""
    root = replaceable_root(name) if replaces else dataset_root(name)
    check = partial(replaceable_root, name)
    with ExitStack() as stack:
        with progress_bar(f"importing {name}", total=len(source), is_shown=is_shown) as on_count:
            imported = data.imported(source, root, replaces=replaces, check_unused=check, on_count=on_count)
            warnings = stack.enter_context(imported)
        yield warnings
