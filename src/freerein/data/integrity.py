"""Whether a dataset is whole: every file as it was written, every count as the files say."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freerein.data import episodes, layout, meta, truth
from freerein.data.reader import Dataset
from freerein.data.spec import DatasetSpec
from freerein.data.trajectory_file import read_rows
from freerein.errors import InvalidInput, ServiceError

_REBUILD = "Open the dataset once while no writer is at work: `meta/` is rebuilt from the data files."
_RESTORE = "Restore the file from a copy; without one, the trajectories before it can be kept."


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a dataset.

    Attributes:
        where: The file, relative to the dataset, or what else it is about.
        sentence: What was expected and what was found.
        hint: How to mend it.
    """

    where: str
    sentence: str
    hint: str


def verify(root: Path) -> list[Problem]:
    """Returns everything that is damaged in a dataset, in order of trajectories; empty when it is whole.

    Every data file is read in full and held against the hash recorded when it was written. Nothing is changed.

    Raises:
        NotFound: There is no dataset in `root`.
    """
    try:
        spec = meta.read_spec(root)
    except InvalidInput as error:
        return [Problem(layout.SPEC_FILE, error.detail, error.hint)]
    if spec is None:
        return list(_foreign_problems(root))
    return [*_data_problems(root, spec), *_count_problems(root, spec), *_truth_problems(root, spec)]


def _data_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    hashes = dict(enumerate(meta.read_episodes(root, spec)["data/sha256"].to_pylist()))
    first_frame, expected = 0, 0
    for file in layout.numbered_files(root / "data"):
        for missing in range(expected, file.index):
            yield Problem(
                _where("data", missing), "The data files must be numbered without a gap; this one is missing.", _RESTORE
            )
        expected = file.index + 1
        try:
            data = layout.trajectory_path(root / "data", file.index).read_bytes()
            length = _check_data_file(root, spec, data=data, index=file.index, first_frame=first_frame)
        except InvalidInput as error:
            yield Problem(_where("data", file.index), error.detail, _RESTORE)
            return
        first_frame += length
        if hashlib.sha256(data).hexdigest() != hashes.get(file.index, hashlib.sha256(data).hexdigest()):
            yield Problem(
                _where("data", file.index), "The file must be as it was written; it has changed since.", _RESTORE
            )


def _check_data_file(root: Path, spec: DatasetSpec, *, data: bytes, index: int, first_frame: int) -> int:
    """Returns a data file's length in timesteps.

    Raises:
        InvalidInput: It is broken, or not the trajectory that its name says.
    """
    described = episodes.describe(data, index=index, first_frame=first_frame)
    columns = layout.data_schema(spec).names
    rows = read_rows(layout.trajectory_path(root / "data", index), index=index, columns=columns)
    if len(rows) != described["length"] or not rows.schema.equals(layout.data_schema(spec)):
        raise InvalidInput(
            f"The file must hold trajectory {index} alone, in the columns that `meta/` names; it does not."
        )
    t = np.arange(len(rows))
    if not (np.array_equal(rows["frame_index"], t) and np.array_equal(rows["index"], first_frame + t)):
        raise InvalidInput(f"The frames must count on from frame {first_frame} of the dataset; they do not.")
    return len(rows)


def _count_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    stored = meta.read_episodes(root, spec)
    sizes = [file.size for file in layout.numbered_files(root / "data")]
    if stored["data/bytes"].to_pylist() != sizes:
        sentence = (
            f"`meta/` must list the {len(sizes)} data files and their sizes; it lists {len(stored)}, or other sizes."
        )
        yield Problem(layout.EPISODES_FILE, sentence, _REBUILD)
    expected, counts = (len(stored), episodes.frame_count(stored)), meta.read_counts(root)
    if counts != expected:
        found = f"{counts[0]} and {counts[1]}" if counts else "nothing that can be read"
        sentence = f"`info.json` must count {expected[0]} trajectories and {expected[1]} frames; it has {found}."
        yield Problem(layout.INFO_FILE, sentence, _REBUILD)


def _truth_problems(root: Path, spec: DatasetSpec) -> Iterator[Problem]:
    lengths = meta.read_episodes(root, spec)["length"].to_pylist()
    for index in truth.labelled(root):
        if index >= len(lengths):
            sentence = "Labels must belong to a trajectory; there is none of this number."
            yield Problem(
                _where("truth", index), sentence, "Open the dataset for writing once: such labels are deleted."
            )
            continue
        try:
            labels = truth.labels(root, index)
        except ServiceError as error:
            yield Problem(_where("truth", index), error.detail, _RESTORE)
            continue
        if len(labels) != lengths[index] or np.any((labels < 0) | (labels >= len(spec.skills))):
            sentence = f"There must be {lengths[index]} labels in [0, {len(spec.skills)}); these are not."
            yield Problem(_where("truth", index), sentence, _RESTORE)


def _foreign_problems(root: Path) -> Iterator[Problem]:
    try:
        dataset = Dataset(root)
    except InvalidInput as error:
        yield Problem("meta", error.detail, error.hint)
        return
    for index in range(len(dataset)):
        try:
            _ = dataset[index]
        except InvalidInput as error:
            yield Problem(f"trajectory {index}", error.detail, error.hint)


def _where(folder: str, index: int) -> str:
    return layout.trajectory_path(Path(folder), index).as_posix()
