"""Whether a dataset is whole: every file as it was written, every count as the files say."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freerein.data import episodes, layout, meta, truth
from freerein.data.episodes import Row
from freerein.data.reader import Dataset
from freerein.data.rows import read_rows
from freerein.data.spec import DatasetSpec
from freerein.errors import InvalidInput, ServiceError

_GAP = "The data files must be numbered without a gap; this one is missing."
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
    recorded = meta.read_episodes(root, spec).select(["dataset_from_index", "data/sha256"]).to_pylist()
    expected = first_frame = 0
    tasks = dict[str, int]()
    for file in layout.numbered_files(root / "data"):
        yield from (Problem(_where("data", index), _GAP, _RESTORE) for index in range(expected, file.index))
        expected, row = file.index + 1, recorded[file.index] if file.index < len(recorded) else None
        first_frame = row["dataset_from_index"] if row else first_frame
        try:
            described = _check_data_file(
                root, spec, index=file.index, first_frame=first_frame, sha256=row and row["data/sha256"], tasks=tasks
            )
            first_frame += described["length"]
        except InvalidInput as error:
            yield Problem(_where("data", file.index), error.detail, _RESTORE)
            if row is None:
                return  # without its length, nothing can be said of the files after it


def _check_data_file(
    root: Path, spec: DatasetSpec, *, index: int, first_frame: int, sha256: str | None, tasks: dict[str, int]
) -> Row:
    """Returns what a data file says of itself.

    Args:
        root: The dataset's folder.
        spec: The dataset's spec.
        index: The trajectory's number.
        first_frame: Number of its first frame in the dataset.
        sha256: Recorded when it was written, if it was.
        tasks: Number of each goal text so far; a new one is added.

    Raises:
        InvalidInput: It is broken, not the trajectory that its name says, or not what was written.
    """
    path, schema = layout.trajectory_path(root / "data", index), layout.data_schema(spec)
    described = episodes.describe(path.read_bytes(), index=index, first_frame=first_frame)
    rows = read_rows(path, index=index, columns=schema.names)
    if len(rows) != described["length"] or not rows.schema.equals(schema):
        raise InvalidInput(f"The file must hold trajectory {index} alone, in the dataset's columns; it does not.")
    t = np.arange(len(rows))
    if not (np.array_equal(rows["frame_index"], t) and np.array_equal(rows["index"], first_frame + t)):
        raise InvalidInput(f"The frames must count on from frame {first_frame} of the dataset; they do not.")
    if sha256 and described["data/sha256"] != sha256:
        raise InvalidInput("The file must be as it was written; it has changed since.")
    number = tasks.setdefault(described["tasks"][0], len(tasks))
    if not np.all(rows["task_index"].to_numpy() == number):
        raise InvalidInput(f"The goal text must be number {number} of the dataset in every frame; it is not.")
    return described


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
