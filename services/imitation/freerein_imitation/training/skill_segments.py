"""Training data of skill policies: timesteps of demonstrations' segments with one predicted skill label."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import Trajectories
from freerein_imitation.training.previous_actions import previous_actions
from freerein_imitation.training.skill_waypoints import Waypoints, find_handling

_LABEL_ERROR = 12  # timesteps, at most, by which a label's end is off

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
    """Returns the runs of equal labels that are long enough; timesteps without a label are in none.

    Args:
        labels: By trajectory, the skill at each timestep, int64 (T,); -1 for none.
        min_steps: Fewest timesteps of a segment.
    """
    found = []
    for trajectory, each in enumerate(labels):
        bounds = [0, *(np.flatnonzero(np.diff(each)) + 1).tolist(), len(each)]
        found += [
            SkillSegment(trajectory, start, stop, int(each[start]))
            for start, stop in pairwise(bounds)
            if each[start] >= 0 and stop - start >= min_steps
        ]
    return found


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

    Args:
        segments: The segments.
        tags: By trajectory, the names of its skills; empty where none is tagged.
        skills: Names of the skills.
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


@dataclass(frozen=True, eq=False)
class SkillSteps:
    """Timesteps of segments, and of the few after each, in which its skill has terminated.

    Attributes:
        trajectory: Index of the trajectory, int64 (N,).
        timestep: int64 (N,).
        skill: Index of the skill, int64 (N,).
        previous: Executed before it, float32 (N, A).
        displacement: To the next waypoint, float32 (N, A).
        is_inside: Whether the timestep is in the segment, bool (N,).
        terminates: Whether the skill terminates, or has terminated, bool (N,).
        object_at: Timestep at which the hand was, or is, where the object is, int64 (N,).
        place_at: Timestep at which the hand released the object, int64 (N,).
    """

    trajectory: Ints
    timestep: Ints
    skill: Ints
    previous: npt.NDArray[np.float32]
    displacement: npt.NDArray[np.float32]
    is_inside: Flags
    terminates: Flags
    object_at: Ints
    place_at: Ints

    def __len__(self) -> int:
        return len(self.timestep)

    def __getitem__(self, items: Ints | slice | Flags) -> "SkillSteps":
        """Returns some of the timesteps."""
        return SkillSteps(**{each.name: getattr(self, each.name)[items] for each in fields(self)})


def end_at_waypoints(
    segments: Sequence[SkillSegment],
    trajectories: Trajectories,
    waypoints: Sequence[Waypoints],
    *,
    is_gripper: Sequence[bool],
) -> list[SkillSegment]:
    """Returns segments with exact bounds, where labels are off by a few timesteps.

    A skill that releases an object ends at the next waypoint, and what follows begins there. Others keep their bounds.

    Args:
        segments: The segments of each trajectory, in order.
        trajectories: The demonstrations.
        waypoints: Of each trajectory.
        is_gripper: For each number of an action, whether it is a gripper's.
    """
    moved: dict[tuple[int, int], int] = {}
    for each in segments:
        executed = np.asarray(trajectories.actions[each.trajectory][each.start : each.stop], np.float32)
        handling = find_handling(executed, is_gripper)
        if handling is not None and each.start + handling.end < len(trajectories.actions[each.trajectory]):
            end = int(waypoints[each.trajectory].upcoming[each.start + handling.end])
            moved[each.trajectory, each.stop] = end if abs(end - each.stop) <= _LABEL_ERROR else each.stop
    exact = [
        replace(
            each,
            start=moved.get((each.trajectory, each.start), each.start),
            stop=moved.get((each.trajectory, each.stop), each.stop),
        )
        for each in segments
    ]
    return [each for each in exact if each.start < each.stop]


def steps_of(
    segments: Sequence[SkillSegment],
    trajectories: Trajectories,
    waypoints: Sequence[Waypoints],
    *,
    is_gripper: Sequence[bool],
    steps_after: int,
) -> SkillSteps:
    """Returns the timesteps of segments.

    Args:
        segments: The segments, at least one.
        trajectories: The demonstrations that they are parts of.
        waypoints: Of each trajectory.
        is_gripper: For each number of an action, whether it is a gripper's.
        steps_after: Timesteps after each segment, where the trajectory has them.
    """

    def steps_of_one(segment: SkillSegment) -> SkillSteps:
        executed = np.asarray(trajectories.actions[segment.trajectory], np.float32)
        last = segment.stop - 1  # where the object is that is not handled
        handling = find_handling(executed[segment.start : segment.stop], is_gripper)
        grasp, release = (
            (segment.start + handling.grasp, segment.start + handling.release) if handling else (last, last)
        )
        timestep = np.arange(segment.start, min(segment.stop + steps_after, len(executed)))  # (n,)
        return SkillSteps(
            trajectory=np.full(len(timestep), segment.trajectory),
            timestep=timestep,
            skill=np.full(len(timestep), segment.skill),
            previous=previous_actions(executed)[timestep],
            displacement=waypoints[segment.trajectory].displacement[timestep],
            is_inside=timestep < segment.stop,
            terminates=timestep >= segment.stop - 1,
            object_at=np.clip(timestep, grasp, release),
            place_at=np.full(len(timestep), release),
        )

    parts = [steps_of_one(each) for each in segments]
    return SkillSteps(
        **{each.name: np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(SkillSteps)}
    )
