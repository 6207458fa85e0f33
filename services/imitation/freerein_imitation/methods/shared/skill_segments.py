"""Segments of demonstrations with one predicted skill label."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split

_LIMIT_FACTOR, _LIMIT_PERCENTILE = 1.5, 95

Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SkillSegment:
    """Consecutive timesteps of one trajectory with one skill label.

    Attributes:
        trajectory: Index of the trajectory.
        start: First timestep.
        stop: Timestep after the last.
        skill: Index of the skill.
    """

    trajectory: int
    start: int
    stop: int
    skill: int


def find_segments(labels: Sequence[Ints], *, min_steps: int) -> list[SkillSegment]:
    """Returns the runs of equal labels that are at least `min_steps` long; timesteps without a label are in none.

    Two runs of one skill with less than that between them are one segment: the skill does not end at a flicker.
    `labels` are, by trajectory, the skill at each timestep, int64 (T,); -1 for none.
    """
    found: list[SkillSegment] = []
    for trajectory, each in enumerate(labels):
        bounds = [0, *(np.flatnonzero(np.diff(each)) + 1).tolist(), len(each)]
        for start, stop in pairwise(bounds):
            if each[start] < 0 or stop - start < min_steps:
                continue
            run = SkillSegment(trajectory, start, stop, int(each[start]))
            before = found[-1] if found else None
            if before and _is_same_skill(before, run) and start - before.stop < min_steps:
                run = replace(found.pop(), stop=stop)
            found.append(run)
    return found


def _is_same_skill(one: SkillSegment, other: SkillSegment) -> bool:
    return (one.trajectory, one.skill) == (other.trajectory, other.skill)


def generous_limit(segments: Sequence[SkillSegment]) -> int:
    """Returns the control steps after which a skill is abandoned: 1.5 times the 95th percentile of segment lengths."""
    lengths = [each.stop - each.start for each in segments]
    return math.ceil(_LIMIT_FACTOR * float(np.percentile(lengths, _LIMIT_PERCENTILE)))


def match_tags(segments: Sequence[SkillSegment], tags: Sequence[Collection[int]]) -> list[SkillSegment]:
    """Returns the segments of trajectories whose skills are the tagged ones, and of those with one skill mistaken.

    Where labels show one skill that is not tagged, and lack one that is, the one was taken for the other: a fit from
    tags may confuse two skills wherever it sees them. Trajectories that differ from their tags in another way are left
    out.

    Args:
        segments: The segments of each trajectory.
        tags: By trajectory, the indices of its skills; empty where they are not known.
    """
    shown: dict[int, set[int]] = {}
    for each in segments:
        shown.setdefault(each.trajectory, set()).add(each.skill)
    meant: dict[int, dict[int, int]] = {}  # by trajectory, the skill that each label stands for
    for trajectory, found in shown.items():
        tagged = set(tags[trajectory]) or found
        untagged, missing = found - tagged, tagged - found
        if len(untagged) == len(missing) <= 1:
            meant[trajectory] = {skill: skill for skill in found} | dict(zip(untagged, missing, strict=True))
    return [replace(each, skill=meant[each.trajectory][each.skill]) for each in segments if each.trajectory in meant]


def keep_tagged(
    segments: Sequence[SkillSegment], tags: Sequence[Collection[str]], *, skills: Sequence[str]
) -> list[SkillSegment]:
    """Returns the segments whose skill is among the tags of their trajectory, or whose trajectory has no tags.

    `tags` are the names of each trajectory's skills; empty where none is tagged.
    """
    return [
        each
        for each in segments
        if not tags or not tags[each.trajectory] or skills[each.skill] in tags[each.trajectory]
    ]


@dataclass(frozen=True)
class SegmentSplit:
    """Segments of different trajectories for training and validation.

    Attributes:
        training: Training segments.
        validation: Validation segments with skills that training ones show.
        skills: Those skills, as they were labelled. The label of a segment here is an index of this.
    """

    training: tuple[SkillSegment, ...]
    validation: tuple[SkillSegment, ...]
    skills: tuple[int, ...]


def split_segments(segments: Sequence[SkillSegment], *, fraction: float, seed: int) -> SegmentSplit:
    """Returns training and validation segments; `fraction` of the trajectories are for validation.

    Raises:
        InvalidInput: Segments are of fewer than 2 trajectories, or validation and training share no skill.
    """
    trajectories = sorted({each.trajectory for each in segments})
    if len(trajectories) < 2:
        raise InvalidInput(
            f"A fit needs segments of at least 2 trajectories, one of them for validation; got {len(trajectories)}.",
            field="dataset",
            hint="Record more demonstrations, and label them.",
        )
    sides = [set(side) for side in train_validation_split(trajectories, fraction=fraction, seed=seed)]
    training, validation = ([each for each in segments if each.trajectory in side] for side in sides)
    skills = sorted({each.skill for each in training})
    split = SegmentSplit(_relabelled(training, skills), _relabelled(validation, skills), tuple(skills))
    if not split.validation:
        raise InvalidInput(
            "The validation trajectories must show a skill that the training ones show; they show none.",
            field="dataset",
            hint="Record more demonstrations, and label them.",
        )
    return split


def _relabelled(segments: Sequence[SkillSegment], skills: Sequence[int]) -> tuple[SkillSegment, ...]:
    """Returns the segments of some skills, labelled by their indices in `skills`."""
    return tuple(replace(each, skill=skills.index(each.skill)) for each in segments if each.skill in skills)
