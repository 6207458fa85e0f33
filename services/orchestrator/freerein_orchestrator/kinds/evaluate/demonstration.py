"""The expert's demonstration of a path, which of its landmarks a robot reached, and why not all of them."""

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
from freerein_orchestrator.envs.truth import Flags, States, truth_session
from freerein_orchestrator.rl.vec_env import Actions, Frames

COMPLETED = "completed"
FAILURES = ("flag", "blocked", "lost")
"""Why a robot did not reach all landmarks; see `failure`."""


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
        FailedPrecondition: The expert does not come to the end, or the task says that the path is not completed.
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
        raise _not_demonstrated("come to its end, after one action at least", path)
    end = int(over[0])
    check_completed(sim, task, path, walked.states[: end + 1])
    steps = np.array([*range(every, end, every), end], np.int64)
    return Demonstration(
        path, steps, walked.states[steps], {camera: walked.frames[camera][steps] for camera in cameras}
    )


def check_completed(sim: SyncClient, task: Task, path: str, states: States) -> None:
    """Checks that a demonstration, true states float64 (T + 1, S), completes its path at some time.

    A task that offers no such predicate is not asked.

    Raises:
        FailedPrecondition: It does not.
    """
    name = f"{COMPLETED}/{path}"
    if name not in [each.name for each in task.predicates]:
        return
    with truth_session(sim, task.name) as truth:
        (holds,) = truth.holds(name, [states])
    if not holds.any():
        raise _not_demonstrated("complete its path", path)


def _not_demonstrated(rule: str, path: str) -> FailedPrecondition:
    return FailedPrecondition(
        f"A demonstration must {rule}; that of {path} does not.",
        field="config.demonstration_seed",
        hint="Choose another seed.",
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


def without_effect(actions: Actions, states: States, hold: Actions) -> Flags:
    """Returns which of T actions, (T, A), other than `hold`, (A,), changed no true state, float64 (T + 1, S): (T,)."""
    return np.asarray((actions != hold).any(axis=1) & (states[1:] == states[:-1]).all(axis=1))


def failure(
    at_landmarks: Flags, goal_index: npt.NDArray[np.int64], is_stuck: Flags, *, max_steps: int, has_touched: bool
) -> str:
    """Returns why a robot did not reach the first landmark that is missing in order; empty where none is.

    `flag`: it went on from that landmark before the step limit, though it was never there while it pursued it.
    `blocked`: else, where half of its actions for that landmark had no effect, or it touched something.
    `lost`: else, such as where it used up its steps elsewhere, or never came to pursue that landmark.

    Args:
        at_landmarks: bool (N, T + 1), whether it was at each landmark at each time.
        goal_index: int64 (T,), number of landmarks that were over at each time; it never falls.
        is_stuck: bool (T,), whether each action had no effect.
        max_steps: Actions after which a landmark is abandoned.
        has_touched: Whether it touched something.
    """
    missing = len(times_in_order(at_landmarks))
    if missing == len(at_landmarks):
        return ""
    begin, end = np.searchsorted(goal_index, [missing, missing + 1]).tolist()  # the actions for it
    goes_on_early = end < len(goal_index) and end - begin < max_steps
    if goes_on_early and not at_landmarks[missing, begin : end + 1].any():
        return "flag"
    stuck = is_stuck[begin:end]
    return "blocked" if has_touched or (len(stuck) and stuck.mean() >= 0.5) else "lost"
