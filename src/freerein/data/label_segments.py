"""The labels of a dataset as segments, for other programs: runs of timesteps of one skill."""

import csv
import io
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.data import labels
from freerein.data.reader import Dataset
from freerein.types.orchestrator import LabelSegment
from freerein.types.segmentation import NO_SKILL


def read_label_segments(root: Path, dataset: Dataset) -> list[list[LabelSegment]]:
    """Returns the segments of each trajectory of a dataset, without gaps.

    Raises:
        FailedPrecondition: The dataset was not labelled, or has grown since.
        InvalidInput: Labels are corrupt or out of range.
    """
    skills = labels.info(root).skills
    return [to_segments(values, skills) for values in labels.all_labels(root, dataset.lengths)]


def to_segments(values: npt.NDArray[np.int64], skills: Sequence[str]) -> list[LabelSegment]:
    """Returns labels, int64 (T,), as segments without gaps; the skill of `NO_SKILL` is empty."""
    bounds = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [
        LabelSegment(start, end, "" if values[start] == NO_SKILL else skills[values[start]])
        for start, end in pairwise(bounds)
        if end > start
    ]


def to_csv(segments: Sequence[Sequence[LabelSegment]]) -> str:
    """Returns the segments of trajectories as a table that `freerein dataset label` reads; those without a skill lack.

    Its columns are `trajectory`, `start`, `end` and `skill`, in timesteps.
    """
    text = io.StringIO()
    rows = ((n, each.start, each.end, each.skill) for n, some in enumerate(segments) for each in some if each.skill)
    csv.writer(text, lineterminator="\n").writerows([("trajectory", "start", "end", "skill"), *rows])
    return text.getvalue()
