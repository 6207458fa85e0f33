"""Predicted skills beside a dataset: what a segmentation model says is executed at each timestep. Learners may read it.

    <root>/labels/chunk-000/file-000.parquet    the labels of data/chunk-000/file-000.parquet
    <root>/labels/info.json                     skills and model, written last: where it is, all labels are

These are guesses made from images, actions and tags; what is true lies elsewhere, and this module does not know where.
"""

import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from freerein.atomic_files import write_atomic
from freerein.data import layout
from freerein.data.rows import refusing_corruption
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.types.common import ModelRef

_FOLDER, _INFO = "labels", "labels/info.json"
_MEND = "Label the dataset first: freerein segment NAME --save."


@dataclass(frozen=True)
class LabelsInfo:
    """What the labels of a dataset are.

    Attributes:
        skills: What they are indices into.
        model: The segmentation model that made them, name and version.
    """

    skills: tuple[str, ...]
    model: ModelRef


def save(root: Path, index: int, values: npt.NDArray[np.int64]) -> None:
    """Writes the labels of a trajectory, int64 (T,), durably; they count once `finish` was called."""
    sink = io.BytesIO()
    pq.write_table(pa.table({"label": pa.array(values, pa.int64())}), sink, write_page_checksum=True)
    write_atomic(layout.trajectory_path(root / _FOLDER, index), sink.getvalue())


def finish(root: Path, info: LabelsInfo) -> None:
    """Says what the labels are, now that those of every trajectory are saved."""
    write_atomic(root / _INFO, json.dumps(asdict(info), indent=2).encode() + b"\n")


def discard(root: Path) -> None:
    """Makes the labels not count any more, before others are written over them."""
    (root / _INFO).unlink(missing_ok=True)


def info(root: Path) -> LabelsInfo:
    """Returns what the labels of a dataset are.

    Raises:
        FailedPrecondition: The dataset was not labelled.
        InvalidInput: The file is corrupt.
    """
    path = root / _INFO
    if not path.is_file():
        raise FailedPrecondition("A dataset must have a skill for every timestep; this one has none.", hint=_MEND)
    try:
        document = json.loads(path.read_bytes())
        model = ModelRef(str(document["model"]["name"]), str(document["model"]["version"]))
        return LabelsInfo(tuple(str(skill) for skill in document["skills"]), model)
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidInput(
            "The description of a dataset's labels must be JSON of ours; it is not.", hint=_MEND
        ) from error


def labels(root: Path, index: int) -> npt.NDArray[np.int64]:
    """Returns the skill at each timestep of a trajectory.

    Returns:
        int64 (T,), indices into the `skills` of `info`.

    Raises:
        FailedPrecondition: The trajectory was not labelled.
        InvalidInput: Its labels are corrupt.
    """
    path = layout.trajectory_path(root / _FOLDER, index)
    if not path.is_file():
        raise FailedPrecondition(f"Trajectory {index} must have a skill for every timestep; it has none.", hint=_MEND)
    with refusing_corruption(f"The labels of trajectory {index}"), path.open("rb") as file:
        table = pq.ParquetFile(file, page_checksum_verification=True).read(use_threads=False)
        values: npt.NDArray[np.int64] = table["label"].to_numpy().astype(np.int64)
        return values


def all_labels(root: Path, lengths: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], ...]:
    """Returns the labels of every trajectory, int64 (T,) each.

    Args:
        root: The dataset's folder.
        lengths: int64 (n,), the timesteps of each trajectory: `Dataset.lengths`.

    Raises:
        FailedPrecondition: The dataset was not labelled, or has grown since.
        InvalidInput: Labels are corrupt, or no indices into the skills.
    """
    skills = info(root).skills
    found = tuple(labels(root, index) for index in range(len(lengths)))
    for index, (values, length) in enumerate(zip(found, lengths, strict=True)):
        if len(values) != length:
            raise FailedPrecondition(
                f"Trajectory {index} must have a skill for each of its {length} timesteps; it has {len(values)}.",
                hint=_MEND,
            )
        if not np.all((values >= 0) & (values < len(skills))):
            raise InvalidInput(f"The labels of trajectory {index} must be in [0, {len(skills)}).", hint=_MEND)
    return found


def fingerprint(values: Sequence[npt.NDArray[np.int64]]) -> str:
    """Returns the sha256, in hexadecimal, over labels: what was learned from them depends on it."""
    digest = hashlib.sha256()
    for each in values:
        digest.update(len(each).to_bytes(8, "little") + each.astype("<i8").tobytes())
    return digest.hexdigest()
