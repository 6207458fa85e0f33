"""Per-timestep skill labels that a segmentation model predicted, beside a dataset. Learners may read them.

    <root>/labels/chunk-000/file-000.parquet    the labels of data/chunk-000/file-000.parquet
    <root>/labels/info.json                     skills and model; written last, so that it marks the labels complete
    <root>/labels/writer.json                   who wrote the labels, complete or not
    <root>/labels/writer.lock                   held while someone does

Ground truth lies elsewhere; this module does not know where.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from freerein.atomic_files import write_atomic
from freerein.data import json_files, layout
from freerein.data.meta import WriterLock
from freerein.data.trajectory_file import read_labels, write_labels
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ModelRef
from freerein.types.segmentation import NO_SKILL

FOLDER = "labels"
"""Name of their folder, in that of the dataset."""

_INFO, _WRITER = "labels/info.json", "labels/writer.json"
_HINT = "Label the dataset first: freerein segment NAME --save."


@dataclass(frozen=True)
class LabelsInfo:
    """Describes the predicted labels of a dataset.

    Attributes:
        skills: Skill names; labels are indices into them, or -1 for none.
        model: Name and version of the segmentation model.
    """

    skills: tuple[str, ...]
    model: ModelRef


def moved(labels: npt.NDArray[np.int64], timesteps: int) -> npt.NDArray[np.int64]:
    """Returns labels (T,) so many timesteps earlier; the last one stays until the end."""
    return labels[np.minimum(np.arange(len(labels)) + timesteps, len(labels) - 1)]


class LabelsWriter:
    """The only writer of a dataset's labels, of a name such as a run's; a context manager.

    The labels are incomplete from now on, durably.

    Attributes:
        goes_on: Whether the last writer had the same name: only then are the labels that it has saved still there.

    Raises:
        FailedPrecondition: Another writer is labelling the dataset.
    """

    def __init__(self, root: Path, *, name: str) -> None:
        self._root = root
        (root / FOLDER).mkdir(exist_ok=True)
        self._lock = WriterLock(root / FOLDER, noun="The labels of a dataset")
        try:
            self.goes_on = self._begin(json.dumps({"writer": name}).encode())
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    def _begin(self, document: bytes) -> bool:
        path = self._root / _WRITER
        goes_on = path.is_file() and path.read_bytes() == document
        (self._root / _INFO).unlink(missing_ok=True)
        write_atomic(path, document)  # syncs the folder, so that the description stays away after a power cut
        return goes_on

    def save(self, index: int, values: npt.NDArray[np.int64]) -> None:
        """Writes the labels of a trajectory, int64 (T,), durably; they are valid once `finish` was called."""
        write_labels(layout.trajectory_path(self._root / FOLDER, index), values)

    def finish(self, info: LabelsInfo) -> None:
        """Marks the labels complete, once those of every trajectory are saved."""
        write_atomic(self._root / _INFO, json.dumps(asdict(info), indent=2).encode() + b"\n")


def info(root: Path) -> LabelsInfo:
    """Returns the description of the labels.

    Raises:
        FailedPrecondition: The dataset was not labelled.
        InvalidInput: The file is corrupt.
    """
    path = root / _INFO
    if not path.is_file():
        raise FailedPrecondition("A dataset must have a skill for every timestep; this one has none.", hint=_HINT)
    try:
        document = json_files.read(path, name=_INFO)
        model = ModelRef(str(document["model"]["name"]), str(document["model"]["version"]))
        return LabelsInfo(tuple(str(skill) for skill in document["skills"]), model)
    except (ValueError, KeyError, TypeError) as error:
        sentence = f"`{_INFO}` must have `skills` and a `model`, as it was written; reading it failed: {error!r}."
        raise InvalidInput(sentence, hint=_HINT) from error


def labels(root: Path, index: int) -> npt.NDArray[np.int64]:
    """Returns the predicted skill at each timestep of a trajectory.

    Returns:
        int64 (T,), indices into the `skills` of `info`; -1 for none, where the segment was rejected.

    Raises:
        FailedPrecondition: The trajectory was not labelled.
        InvalidInput: Its labels are corrupt.
    """
    path = layout.trajectory_path(root / FOLDER, index)
    if not path.is_file():
        raise FailedPrecondition(f"Trajectory {index} must have a skill for every timestep; it has none.", hint=_HINT)
    return read_labels(path, index=index)


def checked_labels(root: Path, index: int, *, timesteps: int, skills: Sequence[str]) -> npt.NDArray[np.int64]:
    """Returns the labels of a trajectory of so many timesteps, int64 (T,), as `labels` does.

    Raises:
        FailedPrecondition: The trajectory was not labelled, or has another length.
        InvalidInput: Labels are corrupt, or no indices into the skills.
    """
    values = labels(root, index)
    if len(values) != timesteps:
        raise FailedPrecondition(
            f"Trajectory {index} must have a skill for each of its {timesteps} timesteps; it has {len(values)}.",
            hint=_HINT,
        )
    if not np.all((values >= NO_SKILL) & (values < len(skills))):
        raise InvalidInput(
            f"The labels of trajectory {index} must be in [0, {len(skills)}), or {NO_SKILL} for none.", hint=_HINT
        )
    return values


def all_labels(root: Path, lengths: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], ...]:
    """Returns the labels of every trajectory, int64 (T,) each, as `labels` does; of these `Dataset.lengths`.

    Raises:
        FailedPrecondition: The dataset was not labelled, or has grown since.
        InvalidInput: Labels are corrupt or out of range.
    """
    skills = info(root).skills
    pairs = enumerate(lengths.tolist())
    return tuple(checked_labels(root, index, timesteps=timesteps, skills=skills) for index, timesteps in pairs)


def fingerprint(values: Sequence[npt.NDArray[np.int64]]) -> str:
    """Returns the sha256 over labels, in hexadecimal."""
    digest = hashlib.sha256()
    for each in values:
        digest.update(len(each).to_bytes(8, "little") + each.astype("<i8").tobytes())
    return digest.hexdigest()
