"""Form `landmarks`: goal images taken from random rollouts, which the policy follows from the same starts.

A landmark counts by true states: the task's predicates `at-landmark` and `object-moves` judge them. Random actions are
the baseline; they go on to the next landmark by true states, too, which no policy can know.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import encode_raw
from freerein_orchestrator.envs.random_policies import exploration_policy
from freerein_orchestrator.envs.truth import Flags, TruthSession, check_predicates, truth_session
from freerein_orchestrator.kinds.evaluate.form import (
    FILMED,
    Figure,
    Form,
    Frames,
    Result,
    Setup,
    Trial,
    ratio_figure,
    share_figure,
)
from freerein_orchestrator.kinds.evaluate.goal_flags import flag_figures
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_no_goal, check_policy, find_policy

AT_LANDMARK, OBJECT_MOVES = "at-landmark", "object-moves"
_EXPLORATION, _BASELINE = 0, 1  # random streams
_FLAGGED = ("at_landmark", "confidence")
_SPLITS = {"": (False, True), "object_moves.": (True,), "no_object_moves.": (False,)}
"""Which landmarks count, by whether an object must move, by prefix of a figure."""


@dataclass(frozen=True, kw_only=True)
class LandmarksConfig(PolicyConfig):
    """Configuration of the form `landmarks`.

    Attributes:
        form: The form.
        landmarks: Landmarks per episode.
        spacing: Timesteps of the random rollout from one landmark to the next.
        steps_per_landmark: Steps after which a landmark is abandoned; 0 for the model's own limit.
    """

    form: Literal["landmarks"] = "landmarks"
    landmarks: int = bounded(4, least=1, most=256)
    spacing: int = bounded(6, least=1, most=1000)
    steps_per_landmark: int = bounded(0, least=0, most=10_000)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_no_goal(self)
        if self.policy == "expert":
            raise InvalidInput(
                "The scripted expert follows recipes, not goal images; the form landmarks needs another policy.",
                field="config.policy",
                hint="Name a goal-conditioned model of the imitation service.",
            )


@dataclass(frozen=True, eq=False)
class Pursuit:
    """Which landmark was pursued at each of T timesteps, and whether the robot was there.

    Attributes:
        landmark: int64 (T,), index of the landmark pursued; N where all N landmarks are over.
        at_landmark: bool (T,), whether the robot was truly at it.
        left: bool (T,), whether it went on to the next landmark, having reached or abandoned this one.
        count: N.
    """

    landmark: npt.NDArray[np.int64]
    at_landmark: Flags
    left: Flags
    count: int

    @property
    def is_active(self) -> Flags:
        """Whether a landmark was still pursued: bool (T,)."""
        return self.landmark < self.count

    @property
    def reached(self) -> Flags:
        """Whether the robot was at the landmark at some time while it pursued it: bool (N,)."""
        return np.array([self.at_landmark[self.landmark == index].any() for index in range(self.count)], bool)

    @property
    def recognized(self) -> Flags:
        """Whether the robot was at the landmark when it left it for the next one: bool (N,)."""
        ends = self.at_landmark & self.left
        return np.array([ends[self.landmark == index].any() for index in range(self.count)], bool)


def pursuit_of(at_landmarks: Flags, goal_index: npt.NDArray[np.int64]) -> Pursuit:
    """Returns how a policy pursued N landmarks.

    Args:
        at_landmarks: bool (N, T), whether the robot was at each landmark at each timestep.
        goal_index: int64 (T,), landmarks that were over according to the answer to each timestep; it never falls.
    """
    count, steps = at_landmarks.shape
    pursued = np.minimum(asked_about(goal_index, is_switched=False), count)
    at_landmark = at_landmarks[np.minimum(pursued, count - 1), np.arange(steps)] & (pursued < count)
    return Pursuit(pursued, at_landmark, np.asarray(goal_index > pursued), count)


def asked_about(goal_index: npt.NDArray[np.int64], *, is_switched: bool) -> npt.NDArray[np.int64]:
    """Returns the landmark that each answer's confidence is about, int64 (T,); N or more where all N are over.

    Args:
        goal_index: int64 (T,), landmarks that were over according to the answer to each timestep.
        is_switched: Whether the policy is told, before it answers, which landmark it pursues, as by `Switching`. Else
            its answer says of the landmark before whether it goes on.
    """
    return goal_index if is_switched else np.concatenate([np.zeros(1, np.int64), goal_index[:-1]])


def reached_by_truth(at_landmarks: Flags, *, max_steps: int) -> Flags:
    """Returns which of N landmarks were reached, bool (N,), by a policy that does not say which one it pursues.

    It goes on to the next landmark as soon as it truly is at one, or after `max_steps`. `at_landmarks` is bool (N, T).
    """
    count, steps = at_landmarks.shape
    reached, index, waited = np.zeros(count, bool), 0, 0
    for t in range(steps):
        if index == count:
            break
        reached[index] = at_landmarks[index, t]
        if reached[index] or waited == max_steps:
            index, waited = index + 1, 0
        waited += 1
    return reached


class LandmarksEvaluation:
    """Explores, and has the policy follow what was seen.

    Attributes:
        subject: The policy.
    """

    def __init__(self, setup: Setup[LandmarksConfig]) -> None:
        config, task = setup.config, setup.task
        check_predicates(task, (AT_LANDMARK, OBJECT_MOVES), form=config.form)
        self._setup = setup
        self._policy = find_policy(setup, max_steps_per_goal=config.steps_per_landmark)
        self._cameras = self._policy.cameras or (task.cameras[0].name,)
        self._max_steps = config.steps_per_landmark or self._policy.max_steps_per_goal
        if not self._max_steps:
            raise InvalidInput(
                "A policy without goals has no limit of its own: `steps_per_landmark` must be at least 1; got 0.",
                field="config.steps_per_landmark",
                hint="Give it the limit of the model that it is compared with.",
            )
        self._steps = np.arange(1, config.landmarks + 1) * config.spacing  # of the landmarks in a random rollout
        if self._steps[-1] > task.max_episode_steps:
            raise InvalidInput(
                f"`landmarks` times `spacing` must be at most {task.max_episode_steps}, the steps of an episode; got "
                f"{self._steps[-1]}.",
                field="config.landmarks",
                hint="Take fewer landmarks, or a smaller spacing.",
            )
        self.subject: dict[str, Any] = self._policy.description

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        setup, policy = self._setup, self._policy
        request = setup.session(count, first, height=policy.height, width=policy.width)
        run = partial(run_episodes, setup.sim, request, interrupt=setup.interrupt)
        random = partial(exploration_policy, setup.task.action)
        explored = run(random(stream=_EXPLORATION), cameras=self._cameras, max_steps=int(self._steps[-1]))
        goals = [self._goal(each) for each in explored]
        steps = self._max_steps * len(self._steps)
        followed = run(policy, goals=goals, max_steps=steps)
        baseline = run(random(stream=_BASELINE), max_steps=steps)
        with truth_session(setup.sim, setup.task.name) as truth:
            landmarks = self._landmark_states(explored)
            at, at_random = (_at_landmarks(truth, episodes, landmarks) for episodes in (followed, baseline))
            moves = truth.holds(
                OBJECT_MOVES,
                [np.repeat(each.states[:1], len(self._steps), axis=0) for each in explored],
                landmarks,
            )
        return [
            self._trial(*each) if len(each[0].actions) >= self._steps[-1] else Trial({})
            for each in zip(explored, followed, at, at_random, moves, strict=True)
        ]

    def _trial(self, explored: Episode, followed: Episode, at: Flags, at_random: Flags, moves: Flags) -> Trial:
        """Returns the measurements of an episode, in which `moves`, bool (N,), says what landmarks need a move."""
        baseline = reached_by_truth(at_random, max_steps=self._max_steps)
        values: dict[str, Any] = {"moves": moves.tolist(), "baseline": baseline.tolist()}
        if followed.goal_index is None or followed.goal_confidence is None:
            reached = reached_by_truth(at, max_steps=self._max_steps)
            values |= {"reached": reached.tolist(), "landmarks_reached": float(reached.mean())}
            return Trial(values, {FILMED: followed.actions})
        pursuit = pursuit_of(at, followed.goal_index)
        active, ends = pursuit.is_active, np.flatnonzero(pursuit.left)
        values |= {
            "reached": pursuit.reached.tolist(),
            "recognized": pursuit.recognized.tolist(),
            "confidence": followed.goal_confidence[active].tolist(),
            "at_landmark": pursuit.at_landmark[active].tolist(),
            "pursuits": [
                {
                    "landmark": int(pursuit.landmark[t]),
                    "step": t,
                    "confidence": float(followed.goal_confidence[t]),
                    "at_landmark": bool(pursuit.at_landmark[t]),
                }
                for t in ends.tolist()
            ],
            "landmarks_reached": float(pursuit.reached.mean()),
        }
        recognized = pursuit.recognized.sum()
        shown = {f"explored-{recognized}": explored.actions, f"followed-{recognized}": followed.actions}
        return Trial(values, shown | {FILMED: followed.actions})

    def _goal(self, explored: Episode) -> Goal:
        """Returns the landmarks as goal images: for each landmark an image of every camera."""
        frames = self._goal_frames(explored)
        landmarks = range(len(self._steps))
        return Goal(tuple(encode_raw(frames[camera][n], camera) for n in landmarks for camera in self._cameras))

    def _goal_frames(self, explored: Episode) -> dict[str, npt.NDArray[np.uint8]]:
        """Returns the frames at the landmarks by camera, uint8 (N, H, W, C)."""
        places = np.minimum(self._steps, len(explored.actions))
        return {camera: explored.frames[camera][places] for camera in self._cameras}

    def _landmark_states(self, explored: Sequence[Episode]) -> list[npt.NDArray[np.float64]]:
        """Returns the landmarks' true states, float64 (N, S) per episode."""
        return [each.states[np.minimum(self._steps, len(each.states) - 1)] for each in explored]

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns figures over the episodes with long enough rollouts, and a median one and the worst as pictures."""
        measured = [index for index, trial in enumerate(trials) if trial.values]
        values = [trials[index].values for index in measured]
        if not values:
            raise InvalidInput(
                f"Random rollouts must last {self._steps[-1]} timesteps; all of them ended before.",
                field="config.landmarks",
                hint="Take fewer landmarks, or a smaller spacing.",
            )
        seed = self._setup.config.seed
        figures = _reached_figures(values, seed=seed)
        counts = {"episodes": len(values), "landmarks": len(values) * len(self._steps)}
        film = self._setup.film(measured[0], trials[measured[0]], self._policy)
        if "recognized" not in values[0]:
            return Result(figures, counts, film=film)
        figures |= _recognizer_figures(values, seed=seed)
        recognized = sorted(sum(each["recognized"]) for each in values)
        pursuits, frames = self._shown(trials, recognized[len(recognized) // 2])
        details: dict[str, Any] = {}
        if recognized[0] < recognized[len(recognized) // 2]:
            details["worst_pursuits"], worst = self._shown(trials, recognized[0])
            frames |= {f"worst_{name}": each for name, each in worst.items()}
        return Result(figures, counts, details, pictures=pursuits, frames=frames, film=film)

    def _shown(self, trials: Sequence[Trial], recognized: int) -> tuple[list[dict[str, Any]], dict[str, Frames]]:
        """Returns the pursuits, goal images and last frames of the first robot that recognized so many landmarks."""
        key = f"followed-{recognized}"
        index = next(index for index, trial in enumerate(trials) if key in trial.shown)
        shown, pursuits = trials[index].shown, trials[index].values["pursuits"]
        replayed = partial(self._setup.replay, index, policy=self._policy)
        goals = replayed(shown[f"explored-{recognized}"], times=self._steps.tolist())
        ends = replayed(shown[key], times=[each["step"] for each in pursuits])
        return pursuits, {"goals": goals, "ends": ends}


def _at_landmarks(
    truth: TruthSession, episodes: Sequence[Episode], landmarks: Sequence[npt.NDArray[np.float64]]
) -> list[Flags]:
    """Returns whether each robot was at each of its N landmarks before each action, bool (N, T) per episode."""
    states = [each.states[:-1] for each in episodes]
    found = [
        truth.holds(
            AT_LANDMARK,
            states,
            [np.broadcast_to(each[n], own.shape) for own, each in zip(states, landmarks, strict=True)],
        )
        for n in range(len(landmarks[0]))
    ]
    return [np.stack(each) for each in zip(*found, strict=True)]


def _reached_figures(values: Sequence[dict[str, Any]], *, seed: int) -> dict[str, Figure]:
    """Returns the shares of landmarks reached: of all, and by whether an object must move."""
    figures = {}
    for prefix, counted in _SPLITS.items():
        kept = [np.isin(each["moves"], counted) for each in values]
        shares = [
            [np.array(each[name], bool)[keep] for each, keep in zip(values, kept, strict=True)]
            for name in ("reached", "baseline")
        ]
        if figure := share_figure(*shares, seed=seed):
            figures[f"{prefix}landmarks_reached"] = figure
    return figures


def _recognized_figures(values: Sequence[dict[str, Any]], *, seed: int) -> dict[str, Figure]:
    """Returns the shares of landmarks that the robot was at when it went on, split as `_reached_figures`."""
    figures = {}
    for prefix, counted in _SPLITS.items():
        flags = [np.array(each["recognized"], bool)[np.isin(each["moves"], counted)] for each in values]
        if counts := [[len(each)] for each in flags if len(each)]:
            sums = [[each.sum()] for each in flags if len(each)]
            figures[f"{prefix}landmarks_recognized"] = ratio_figure(sums, counts, seed=seed)
    return figures


def _recognizer_figures(values: Sequence[dict[str, Any]], *, seed: int) -> dict[str, Figure]:
    """Returns the quality of the goal recognizer on the states that the policy visited."""
    at_landmark, confidence = (list(chain.from_iterable(each[name] for each in values)) for name in _FLAGGED)
    sums, counts = ([[fold(each["at_landmark"])] for each in values] for fold in (sum, len))
    return {
        **_recognized_figures(values, seed=seed),
        "visited.at_landmark": ratio_figure(sums, counts, seed=seed),
        **{f"visited.{name}": figure for name, figure in flag_figures(confidence, at_landmark).items()},
    }


FORM = Form(LandmarksConfig, LandmarksEvaluation, check_policy)
