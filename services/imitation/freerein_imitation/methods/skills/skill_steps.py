"""Training data of skills: timesteps of segments, with the next waypoint and where the object is."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.shared.skill_segments import Flags, Ints, SkillSegment
from freerein_imitation.methods.shared.trajectory_batches import previous_actions
from freerein_imitation.methods.skills.waypoints import Waypoints, find_handling

_LABEL_ERROR = 12  # timesteps, at most, by which a label's end is off


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
        object_at: Timestep at which the gripper was, or is, where the object is, int64 (N,).
        place_at: Timestep at which the gripper released the object, int64 (N,).
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

    The segments of each trajectory are in order, and `waypoints` are those of each trajectory.
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
    """Returns the timesteps of one or more segments, and `steps_after` after each where the trajectory has them."""

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
