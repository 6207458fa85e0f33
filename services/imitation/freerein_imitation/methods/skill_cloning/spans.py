"""Training batches of skill cloning: spans of consecutive timesteps of demonstrations, each with the frames before it.

Encoding images dominates an update's cost, so that each frame of a span is encoded once, and is the newest of one
observation and an earlier one of the next few.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
import torch

from freerein.learning.encoders import FrameTensors
from freerein.learning.trajectories import Trajectories, TrajectoryArrays
from freerein_imitation.methods.shared.skill_segments import Flags, Ints, SkillSegment

D = TypeVar("D", bound=np.generic)

NONE = -1
"""Stands for no skill."""

RobotStates: TypeAlias = Sequence[npt.NDArray[np.float32]]
"""By trajectory, the robot's own state, float32 (T, S); empty for learners that take none."""


@dataclass(frozen=True, eq=False)
class SkillTimes:
    """The skills of a trajectory's T timesteps; indices are -1 outside of segments that were kept.

    Attributes:
        skill: The skill that is executed, int64 (T,).
        stop: Timestep after its segment, int64 (T,).
        ended: The skill that has ended shortly before, int64 (T,).
    """

    skill: Ints
    stop: Ints
    ended: Ints

    @classmethod
    def of(cls, segments: Sequence[SkillSegment], length: int, *, steps_after: int) -> "SkillTimes":
        """Returns the skills of a trajectory of `length` timesteps, by its segments that were kept.

        In `steps_after` timesteps after a segment its skill counts as ended.
        """
        skill, stop, ended = (np.full(length, NONE) for _ in range(3))
        for each in segments:
            skill[each.start : each.stop], stop[each.start : each.stop] = each.skill, each.stop
            ended[each.stop : each.stop + steps_after] = each.skill
        return cls(skill, stop, ended)


@dataclass(frozen=True, eq=False)
class SpanBatch:
    """B spans of L timesteps, and the n frames before each.

    Attributes:
        frames: By camera, uint8 (B * (n + L), H, W, C), span after span.
        robot_states: The robot's own state at these frames, float32 (B * (n + L), S); None for learners without.
        is_known: Of the earlier frames of each timestep, newest first, which there are: bool (B, L, n).
        executed: Actions before each timestep, newest first, (B, L, m, A); `ActionSpec.no_action` for none.
        actions: Executed at each timestep and after it, (B, L, K, A).
        is_own: Which of these belong to the same segment, bool (B, L, K).
        skill: The skill that is executed, int64 (B, L); -1 for none.
        terminates: Whether the timestep is the last of its segment, bool (B, L).
        ended: The skill that has ended shortly before, int64 (B, L); -1 for none.
    """

    frames: FrameTensors
    robot_states: npt.NDArray[np.float32] | None
    is_known: Flags
    executed: npt.NDArray[np.generic]
    actions: npt.NDArray[np.generic]
    is_own: Flags
    skill: Ints
    terminates: Flags
    ended: Ints


@dataclass(frozen=True)
class Spans:
    """Reads spans of demonstrations.

    Attributes:
        demonstrations: Frames and executed actions.
        times: The skills of each trajectory.
        no_action: Stands for no action, (A,).
        earlier: n, frames before a timestep.
        past_actions: m, actions before a timestep.
        chunk: K, actions from a timestep on.
        robot_states: The robot's own states in the demonstrations.
    """

    demonstrations: Trajectories
    times: Sequence[SkillTimes]
    no_action: npt.NDArray[np.generic]
    earlier: int
    past_actions: int
    chunk: int
    robot_states: RobotStates = ()

    def read(self, trajectories: Ints, starts: Ints, length: int) -> SpanBatch:
        """Returns the spans of some trajectories, int64 (B,), that begin at some timesteps, int64 (B,).

        What lies beyond the end of a trajectory belongs to no skill.
        """
        chosen = list(zip(trajectories.tolist(), starts.tolist(), strict=True))
        steps = starts[:, None] + np.arange(length)  # (B, L)
        times = [self.times[item] for item, _ in chosen]
        skill, stop, ended = (
            np.stack([_at(values, row, NONE) for values, row in zip(columns, steps, strict=True)])
            for columns in zip(*((each.skill, each.stop, each.ended) for each in times), strict=True)
        )
        before, after = np.arange(1, self.past_actions + 1), np.arange(self.chunk)
        shown = self.demonstrations.frames
        return SpanBatch(
            {name: torch.from_numpy(self._seen(each, chosen, length)) for name, each in shown.items()},
            self._seen(self.robot_states, chosen, length) if self.robot_states else None,
            steps[..., None] - np.arange(1, self.earlier + 1) >= 0,
            self._actions(chosen, steps[..., None] - before),
            self._actions(chosen, steps[..., None] + after),
            (steps[..., None] + after < stop[..., None]) & (skill != NONE)[..., None],
            skill,
            (skill != NONE) & (steps == stop - 1),
            ended,
        )

    def _seen(self, arrays: TrajectoryArrays[D], chosen: Sequence[tuple[int, int]], length: int) -> npt.NDArray[D]:
        """Returns the observations of spans and of the timesteps before them, (B * (n + L), ...).

        Before and after a trajectory it is the first and the last observation.
        """
        offsets = np.arange(-self.earlier, length)
        return np.concatenate([arrays[item][np.clip(at + offsets, 0, len(arrays[item]) - 1)] for item, at in chosen])

    def _actions(self, chosen: Sequence[tuple[int, int]], steps: Ints) -> npt.NDArray[np.generic]:
        """Returns the actions at timesteps (B, L, n): (B, L, n, A)."""
        executed = self.demonstrations.actions
        return np.stack(
            [_at(executed[item], row, self.no_action) for (item, _), row in zip(chosen, steps, strict=True)]
        )


def _at(values: npt.NDArray[np.generic], steps: Ints, missing: npt.ArrayLike) -> npt.NDArray[np.generic]:
    """Returns the values (T, ...) at timesteps (...), `missing` outside of the trajectory: (..., ...)."""
    is_inside = (steps >= 0) & (steps < len(values))
    found = values[np.clip(steps, 0, len(values) - 1)]
    return np.where(is_inside.reshape(is_inside.shape + (1,) * (found.ndim - steps.ndim)), found, missing)
