"""Annotations that people bring as CSV files: tags of trajectories, and true labels of a few for evaluation.

    trajectory,skills            trajectory,start,end,skill
    0,reach;pour                 0,0,41,reach
    1,reach;stir                 0,41,90,pour

A trajectory is named by its index, LeRobot's `episode_index`. Nothing changes unless the whole file is valid.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data import meta, tags, truth
from freerein.data.meta import WriterLock
from freerein.data.reader import Dataset
from freerein.data.tags import Tags
from freerein.errors import FailedPrecondition, InvalidInput

_TAG_COLUMNS = ("trajectory", "skills")
_LABEL_COLUMNS = ("trajectory", "start", "end", "skill")
_SEPARATOR = ";"
_MAX_SKILL = 64
_NAMED_TWICE = ("name each trajectory once; it names one again", "Join the two lines.")


@dataclass(frozen=True)
class _Line:
    """A line of a CSV file: its number, from 1, and its cells by column."""

    number: int
    cells: dict[str, str]

    def integer(self, column: str, *, least: int, most: int) -> int:
        """Returns a cell that must be a whole number in [least, most]."""
        text = self.cells[column].strip()
        if not (text.isascii() and text.isdigit() and len(text) < 19 and least <= int(text) <= most):
            raise self.error(column, f"be a whole number in [{least}, {most}]; it is not", "Count from 0.")
        return int(text)

    def skills(self) -> tuple[str, ...]:
        """Returns the skills that the column `skills` names, sorted; empty for an empty cell."""
        text = self.cells["skills"].strip()
        names = [name.strip() for name in text.split(_SEPARATOR)] if text else []
        if not all(0 < len(name) <= _MAX_SKILL and name.isprintable() for name in names):
            raise self.error(
                "skills",
                f"hold names of 1 to {_MAX_SKILL} characters, separated by `{_SEPARATOR}`; it does not",
                "For example: reach;pour.",
            )
        return tuple(sorted(set(names)))

    def error(self, column: str, expected: str, hint: str) -> InvalidInput:
        """Returns the error of a cell."""
        return InvalidInput(f"Line {self.number}, column `{column}`, must {expected}.", field=column, hint=hint)


def tag(root: Path, table: bytes) -> int:
    """Tags trajectories of a dataset with the skills that occur in them; returns how many.

    An empty cell takes the tags away. The dataset's skills are afterwards those of its trajectories; while some have
    true labels, which are indices into them, no skill is removed.

    Args:
        root: The dataset's folder.
        table: CSV with the columns `trajectory` and `skills`, several separated by semicolons; other trajectories
            keep their tags.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A line is not as above; the error names line and column.
        FailedPrecondition: The dataset is being written.
    """
    with closing(WriterLock(_existing(root))):
        dataset = Dataset(root)
        given = _tags(table, count=len(dataset))
        earlier = tags.read(root)
        merged = {**(earlier.by_trajectory if earlier else {}), **given}
        skills = [given.get(index, each) for index, each in enumerate(dataset.skills)]
        occurring = {skill for each in skills for skill in each}
        kept = [skill for skill in dataset.spec.skills if skill in occurring or truth.labelled(root)]
        tags.save(root, Tags((*kept, *sorted(occurring - set(kept))), merged))
        spec = meta.read_spec(root)
        if spec is not None:
            meta.save(root, spec, meta.load(root, spec)[0])
    return len(given)


def label(root: Path, table: bytes) -> int:
    """Stores true labels of a few trajectories, for evaluation only; returns of how many.

    Args:
        root: The dataset's folder.
        table: CSV with the columns `trajectory`, `start`, `end` and `skill`: segments [start, end), which cover each
            named trajectory from its first to its last timestep.

    Raises:
        NotFound: There is no dataset in `root`.
        InvalidInput: A line is not as above; the error names line and column.
        FailedPrecondition: The dataset is being written, or another tool wrote it.
    """
    with closing(WriterLock(_existing(root))):
        dataset = Dataset(root)
        if meta.read_spec(root) is None:
            raise FailedPrecondition(
                "True labels must belong to a dataset that freerein wrote; another tool wrote this one.",
                hint="Import it first: freerein dataset import PATH NAME.",
            )
        labels = _labels(table, dataset)
        for index, values in labels.items():
            truth.save(root, index, values)
    return len(labels)


def read_tags(table: bytes, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Returns the skills of trajectories by name, as `tag` reads those by index.

    Raises InvalidInput where a line is not as there, or names none of the trajectories `names`.
    """
    given = dict[str, tuple[str, ...]]()
    for line in _lines(table, _TAG_COLUMNS):
        name = line.cells["trajectory"].strip()
        if name not in names:
            raise line.error("trajectory", "name a trajectory that is there; it does not", f"The first is {names[0]}.")
        if name in given:
            raise line.error("trajectory", *_NAMED_TWICE)
        given[name] = line.skills()
    return given


def _existing(root: Path) -> Path:
    """Returns the folder of a dataset; raises NotFound where there is none, before a lock is made there."""
    Dataset(root)
    return root


def _tags(table: bytes, *, count: int) -> dict[int, tuple[str, ...]]:
    given = dict[int, tuple[str, ...]]()
    for line in _lines(table, _TAG_COLUMNS):
        index = line.integer("trajectory", least=0, most=count - 1)
        if index in given:
            raise line.error("trajectory", *_NAMED_TWICE)
        given[index] = line.skills()
    return given


def _labels(table: bytes, dataset: Dataset) -> dict[int, npt.NDArray[np.int64]]:
    """Returns the labels of each named trajectory, int64 (T,)."""
    skills, labels, last = dataset.spec.skills, dict[int, npt.NDArray[np.int64]](), dict[int, _Line]()
    for line in _lines(table, _LABEL_COLUMNS):
        index = line.integer("trajectory", least=0, most=len(dataset) - 1)
        values = labels.setdefault(index, np.full(dataset.lengths[index], -1, np.int64))
        start = line.integer("start", least=0, most=len(values) - 1)
        end = line.integer("end", least=start + 1, most=len(values))
        if line.cells["skill"].strip() not in skills:
            names = ", ".join(skills) or "none yet"
            raise line.error("skill", f"be one of the dataset's skills, {names}; it is not", "Tag the dataset first.")
        if np.any(values[start:end] >= 0):
            raise line.error("start", "begin where no other segment is; it overlaps one", "Segments are [start, end).")
        values[start:end], last[index] = skills.index(line.cells["skill"].strip()), line
    for index, values in labels.items():
        missing = np.flatnonzero(values < 0)
        if len(missing):
            raise last[index].error(
                "end",
                f"complete a trajectory of {len(values)} timesteps; timestep {missing[0]} of trajectory {index} has no "
                "label",
                "The segments of a trajectory cover all of it.",
            )
    return labels


def _lines(table: bytes, columns: tuple[str, ...]) -> Iterator[_Line]:
    """Yields the lines after the header; lines without any text are left out."""
    try:
        reader = csv.reader(io.StringIO(table.decode("utf-8-sig"), newline=""), strict=True)
        header = [name.strip() for name in next(reader, [])]
        if header != list(columns):
            raise InvalidInput(
                f"Line 1 must be `{','.join(columns)}`; it is not.",
                field="header",
                hint="Columns are separated by commas, in this order.",
            )
        for cells in reader:
            if any(cell.strip() for cell in cells):
                if len(cells) != len(columns):
                    raise InvalidInput(
                        f"Line {reader.line_num} must have {len(columns)} columns; it has {len(cells)}.",
                        field=columns[min(len(cells), len(columns) - 1)],
                        hint="Put text that holds a comma into quotes.",
                    )
                yield _Line(reader.line_num, dict(zip(columns, cells, strict=True)))
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(
            "The file must be CSV in UTF-8; it is not.", hint="Save it as CSV, separated by commas."
        ) from None
