"""The expert's demonstration of a path, and which of its landmarks a robot reached."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import FailedPrecondition
from freerein.types.common import Goal
from freerein.types.sim import CreateSessionRequest, Recipe, Task
from freerein_orchestrator.envs.episodes import run_episodes
from freerein_orchestrator.envs.policies import encode_raw, expert_policy
from freerein_orchestrator.envs.truth import Flags, States
from freerein_orchestrator.rl.vec_env import Frames


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A demonstration of T actions, and N landmarks of it.

    Attributes:
        path: The skill that it shows.
        steps: int64 (N,), actions before each landmark; the last one is T.
        states: float64 (N, S), true states at the landmarks.
        frames: By camera, uint8 (N, H, W, C), what was seen there.
    """

    path: str
    steps: npt.NDArray[np.int64]
    states: States
    frames: Mapping[str, Frames]

    @property
    def length(self) -> int:
        """Its actions."""
        return int(self.steps[-1])

    @property
    def landmarks(self) -> list[Goal]:
        """The landmarks as goals: of each an image of every camera."""
        return [
            Goal(tuple(encode_raw(frames[n], camera) for camera, frames in self.frames.items()))
            for n in range(len(self.steps))
        ]


def demonstrate(
    sim: SyncClient,
    task: Task,
    request: CreateSessionRequest,
    path: str,
    interrupt: Callable[[], None],
    *,
    cameras: Sequence[str],
    every: int,
) -> Demonstration:
    """Returns the expert's demonstration of a path: each `every`-th frame after the first, and the last, are landmarks.

    Args:
        sim: The sim service's client.
        task: The task.
        request: A privileged session of one environment.
        path: A skill of the task.
        interrupt: Called before each step; raises to stop.
        cameras: What is seen.
        every: Actions from one landmark to the next.

    Raises:
        FailedPrecondition: The expert does not come to the end.
        InvalidInput: The task has no expert, or the skill is no recipe.
        ServiceError: The service failed.
    """
    (walked,) = run_episodes(
        sim,
        request,
        expert_policy(sim, task),
        interrupt,
        goals=[Goal(recipe=(path,))],
        recipes=[Recipe((path,))],
        cameras=cameras,
        last_goals=[1],
    )
    over = np.zeros(0, np.int64) if walked.goal_index is None else np.flatnonzero(walked.goal_index)
    if not len(over) or not over[0]:
        raise FailedPrecondition(
            f"A demonstration must come to its end, after one action at least; that of {path} does not.",
            field="config.demonstration_seed",
            hint="Choose another seed.",
        )
    end = int(over[0])
    steps = np.array([*range(every, end, every), end], np.int64)
    return Demonstration(
        path, steps, walked.states[steps], {camera: walked.frames[camera][steps] for camera in cameras}
    )


def times_in_order(at_landmarks: Flags) -> list[int]:
    """Returns when a robot was first at each landmark, in order, up to the first that it did not reach.

    Args:
        at_landmarks: bool (N, T), whether it was at each landmark at each time. A landmark counts once all those before
            it have been reached.
    """
    times, begin = list[int](), 0
    for at in at_landmarks:
        found = np.flatnonzero(at[begin:])
        if not len(found):
            break
        begin += int(found[0])
        times.append(begin)
    return times


def times_left(
    goal_index: npt.NDArray[np.int64] | None, demonstrated: npt.NDArray[np.int64], *, length: int
) -> npt.NDArray[np.int64]:
    """Returns when a robot went on from each landmark, int64 (N,); its last time, T, where it did not.

    Args:
        goal_index: int64 (T,), number of landmarks that were over at each time; None for a robot that is given none: it
            counts where the demonstration was as long.
        demonstrated: int64 (N,), actions of the demonstration before each landmark.
        length: T, the robot's actions.
    """
    if goal_index is None:
        return np.minimum(demonstrated, length)
    is_over = goal_index[:, None] > np.arange(len(demonstrated))  # (T, N)
    return np.where(is_over.any(axis=0), is_over.argmax(axis=0), length)


def stopped_at(at_landmarks: Flags, goal_index: npt.NDArray[np.int64]) -> bool:
    """Returns whether a robot was at the last of N landmarks when it first said that this one, too, was over.

    Args:
        at_landmarks: bool (N, T + 1), whether it was at each landmark at each time.
        goal_index: int64 (T,), number of landmarks that were over at each time.
    """
    said = np.flatnonzero(goal_index >= len(at_landmarks))
    return bool(at_landmarks[-1, said[:1]].any())


def efficiency(demonstrated: npt.NDArray[np.int64], times: Sequence[int]) -> float:
    """Returns the demonstration's actions by those of a robot, to the farthest landmark that it reached; at most 1.

    Args:
        demonstrated: int64 (N,), actions of the demonstration before each landmark.
        times: Actions of the robot before each landmark that it reached in order; without any the efficiency is 0.
    """
    return min(1.0, float(demonstrated[len(times) - 1]) / max(times[-1], 1)) if times else 0.0
