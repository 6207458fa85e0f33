"""Form `demonstrations`: the policy follows the expert's demonstrations of paths, given as sequences of goal images.

A path is a skill of the task. Its demonstration is the same in all trials; episodes begin where the path does, as the
task's conditions say, such as in any direction. Landmarks count by true states, in order: the task's predicate
`at-landmark` judges them, and others named `at-landmark/WHAT` beside it. Measures of the task, if any, compare the
state in which the policy went on from each landmark with that of the landmark.

Trials are run in rounds, and a round ends once the policy has gone on from the last landmark in all of its trials.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.config import bounded
from freerein.errors import InvalidInput, must_be
from freerein.types.common import Goal
from freerein.types.sim import CreateSessionRequest, Recipe
from freerein_orchestrator.envs.episodes import Episode, derive_seed, run_episodes
from freerein_orchestrator.envs.switching import Switching
from freerein_orchestrator.envs.truth import Flags, TruthSession, check_predicates, truth_session
from freerein_orchestrator.kinds.evaluate.demonstration import (
    COMPLETED,
    FAILURES,
    Demonstration,
    demonstrate,
    efficiency,
    failure,
    stopped_at,
    times_in_order,
    times_left,
    without_effect,
)
from freerein_orchestrator.kinds.evaluate.form import (
    FILMED,
    Figure,
    Form,
    Result,
    Setup,
    Trial,
    mean_figure,
    median_figure,
)
from freerein_orchestrator.kinds.evaluate.goal_flags import flag_figures
from freerein_orchestrator.kinds.evaluate.landmarks import AT_LANDMARK, asked_about, pursuit_of
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_no_goal, check_policy, find_policy

CONTACT = "contact"
_FLAGGED = ("confidence", "at_landmark")


@dataclass(frozen=True, kw_only=True)
class DemonstrationsConfig(PolicyConfig):
    """Configuration of the form `demonstrations`. Trial i follows the path of number i modulo their number.

    Attributes:
        form: The form.
        paths: Skills of the task that are demonstrated; empty for all.
        every: Actions of a demonstration from one landmark to the next; its last frame is a landmark, too.
        demonstration_seed: Seed of the demonstrations.
        demonstration_conditions: Conditions under which they are shown; those of the trials are `conditions`.
        steps_per_landmark: Steps after which a landmark is abandoned; 0 for the model's own limit.
        length_factor: A trial lasts so many times as long as its demonstration.
        most_steps: Most actions of a trial, whatever `length_factor` says; 0 for no such limit.
        switching: By the `policy`'s own flag; by `steps`, the next landmark is its goal after `steps_per_landmark`; or
            by the `truth`, a ceiling: once it truly is at the present one, or has used up its steps.
        measures: Whether the task's measures are taken; each may take longer than the trial.
    """

    form: Literal["demonstrations"] = "demonstrations"
    paths: tuple[str, ...] = ()
    every: int = bounded(10, least=1, most=1000)
    demonstration_seed: int = bounded(0, least=0, most=2**31 - 1)
    demonstration_conditions: tuple[str, ...] = ()
    steps_per_landmark: int = bounded(0, least=0, most=10_000)
    length_factor: float = bounded(5.0, least=1.0, most=100.0)
    most_steps: int = bounded(0, least=0, most=100_000)
    switching: Literal["policy", "steps", "truth"] = "policy"
    measures: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_no_goal(self)
        if self.switching != "policy" and isinstance(self.policy, str):
            raise _not_switched(self.policy)


class DemonstrationsEvaluation:
    """Has the policy follow demonstrations.

    Attributes:
        subject: The policy.
    """

    def __init__(self, setup: Setup[DemonstrationsConfig]) -> None:
        config, task = setup.config, setup.task
        check_predicates(task, [AT_LANDMARK], form=config.form)
        if unknown := set(config.paths) - set(task.skills):
            rule = f"among the task's skills, {', '.join(task.skills) or 'none'}"
            raise must_be("paths", rule, f"{len(unknown)} others", field="config.paths")
        self._setup = setup
        self._policy = find_policy(setup, max_steps_per_goal=config.steps_per_landmark)
        if config.switching != "policy" and not self._policy.max_steps_per_goal:
            raise _not_switched("this one")
        self._cameras = self._policy.cameras or (task.cameras[0].name,)
        self._demonstrations = [self._demonstrate(path) for path in config.paths or task.skills]
        offered = [each.name for each in task.predicates]
        self._judges = [name for name in offered if name == AT_LANDMARK or name.startswith(f"{AT_LANDMARK}/")]
        self._measures = [each.name for each in task.measures if each.needs_reference and config.measures]
        self._has_contact = CONTACT in offered
        self._completed = {f"{COMPLETED}/{each.path}" for each in self._demonstrations} <= set(offered)
        self.subject: dict[str, Any] = {**self._policy.description, "switching": config.switching}

    @property
    def _is_expert(self) -> bool:
        """Whether the expert acts, whose one goal is the whole path."""
        return self._setup.config.policy == "expert"

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        setup, shown = self._setup, [self._shown(first + env) for env in range(count)]
        steps = max(map(self._most_steps, shown))
        policy = self._policy
        request = setup.session(count, first, height=policy.height, width=policy.width, max_steps=steps)
        recipes = [Recipe((each.path,)) for each in shown]
        run = partial(run_episodes, setup.sim, request, interrupt=setup.interrupt, recipes=recipes, max_steps=steps)
        followed = self._follow(run, shown)
        episodes = [_cut(each, self._most_steps(own)) for each, own in zip(followed, shown, strict=True)]
        with truth_session(setup.sim, setup.task.name) as truth:
            at = {judge: _at_landmarks(truth, judge, episodes, shown) for judge in self._judges}
            outcomes = self._outcomes(truth, episodes, shown)
        return [
            self._trial(shown[env], episodes[env], {judge: each[env] for judge, each in at.items()}, outcomes[env])
            for env in range(count)
        ]

    def _follow(self, run: Callable[..., Sequence[Episode]], shown: Sequence[Demonstration]) -> Sequence[Episode]:
        """Returns the policy's episodes."""
        if self._is_expert:
            return run(self._policy, goals=[Goal(recipe=(each.path,)) for each in shown], last_goals=[1] * len(shown))
        landmarks = [each.landmarks for each in shown]
        counts = [len(each) for each in landmarks]
        if self._setup.config.switching == "policy":
            goals = [Goal(tuple(chain.from_iterable(goal.images for goal in each))) for each in landmarks]
            return run(self._policy, goals=goals, last_goals=counts)

        with truth_session(self._setup.sim, self._setup.task.name) as truth:

            def is_at(states: npt.NDArray[np.float64], index: npt.NDArray[np.int64]) -> Flags:
                there = [each.states[n][None] for each, n in zip(shown, index.tolist(), strict=True)]
                return np.concatenate(truth.holds(AT_LANDMARK, [state[None] for state in states], there))

            judge = is_at if self._setup.config.switching == "truth" else None
            switching = Switching(landmarks, judge, max_steps=self._policy.max_steps_per_goal)
            policy = switching.switch(self._policy)
            return run(policy, goals=switching.goals, tell=switching.tell, last_goals=counts)

    def _outcomes(
        self, truth: TruthSession, episodes: Sequence[Episode], shown: Sequence[Demonstration]
    ) -> list[dict[str, Any]]:
        """Returns measures of each episode, whether the path was walked, and whether the robot touched something."""
        found: list[dict[str, Any]] = []
        for env, (episode, own) in enumerate(zip(episodes, shown, strict=True)):
            found.append(self._measured(truth, episode, own))
            if self._completed:
                (walked,) = truth.holds(f"{COMPLETED}/{own.path}", [episode.states])
                found[env]["success"] = bool(walked.any())
            if self._has_contact:
                (touched,) = truth.holds(CONTACT, [episode.states])
                found[env]["contact"] = bool(touched.any())
        return found

    def _measured(self, truth: TruthSession, episode: Episode, shown: Demonstration) -> dict[str, list[float]]:
        """Returns each measure where the policy went on from each landmark, by name."""
        index = None if self._is_expert else episode.goal_index
        states = episode.states[times_left(index, shown.steps, length=len(episode.actions))]
        return {name: truth.values(name, states, shown.states).tolist() for name in self._measures}

    def _trial(
        self, shown: Demonstration, episode: Episode, at: Mapping[str, Flags], outcome: Mapping[str, Any]
    ) -> Trial:
        """Returns the measurements of an episode, in which the robot was at landmarks, bool (N, T + 1), by judge."""
        times = {judge: times_in_order(each) for judge, each in at.items()}
        values: dict[str, Any] = {
            "path": shown.path,
            "steps": self._steps(shown, episode),
            "times": times[AT_LANDMARK],
            "farthest_at": max(times[AT_LANDMARK], default=0),
            **{_figure("completion", judge): len(each) / len(shown.steps) for judge, each in times.items()},
            **{_figure("efficiency", judge): efficiency(shown.steps, each) for judge, each in times.items()},
            **outcome,
            **self._pursued(episode, at, has_touched=outcome.get("contact", False)),
        }
        return Trial(values, {FILMED: episode.actions})

    def _steps(self, shown: Demonstration, episode: Episode) -> int:
        """Returns the actions until the policy went on from its last goal, or until the end of its trial."""
        goals = 1 if self._is_expert else len(shown.steps)
        index = episode.goal_index
        return len(episode.actions) if index is None else int(np.searchsorted(index, goals))

    def _pursued(self, episode: Episode, at: Mapping[str, Flags], *, has_touched: bool) -> dict[str, Any]:
        """Returns how a policy pursued landmarks, and what kept it from the first that is missing; else nothing."""
        index, confidence, config = episode.goal_index, episode.goal_confidence, self._setup.config
        if index is None or confidence is None:
            return {}
        pursuit = pursuit_of(at[AT_LANDMARK][:, :-1], index)
        asked = asked_about(index, is_switched=config.switching != "policy")
        active = np.flatnonzero(asked < pursuit.count)
        failed = failure(
            at[AT_LANDMARK],
            index,
            without_effect(episode.actions, episode.states, self._setup.task.action.hold_action()),
            max_steps=self._policy.max_steps_per_goal,
            has_touched=has_touched,
        )
        return {
            "confidence": confidence[active].tolist(),
            "at_landmark": at[AT_LANDMARK][asked[active], active].tolist(),
            "recognized": float(pursuit.recognized.mean()),
            "ended": bool(index[-1] >= pursuit.count),
            **{_figure("stopped", judge): stopped_at(each, index) for judge, each in at.items()},
            **{f"failed.{each}": int(each == failed) for each in FAILURES},
        }

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials, and what each path came to."""
        values, config = [trial.values for trial in trials], self._setup.config
        figures = _figures(values, self._judges, seed=config.seed)
        for name in self._measures:
            figures[name] = mean_figure([float(np.mean(each[name])) for each in values], seed=config.seed)
            figures[f"{name}.last"] = mean_figure([each[name][-1] for each in values], seed=config.seed)
        counts = {"episodes": len(values), "paths": len(self._demonstrations)}
        details = {"paths": [self._path(each, values) for each in self._demonstrations]}
        film = self._setup.film(
            0,
            trials[0],
            self._policy,
            recipes=[Recipe((self._shown(0).path,))],
            episode_steps=self._most_steps(self._shown(0)),
        )
        return Result(figures, counts, details, film=film)

    def _path(self, shown: Demonstration, values: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Returns what a path is, the median completion of it, and mean measures by landmark, JSON."""
        own = [each for each in values if each["path"] == shown.path]
        return {
            "path": shown.path,
            "steps": shown.length,
            "landmarks": len(shown.steps),
            "completion": float(np.median([each["completion"] for each in own])) if own else None,
            **{name: np.mean([each[name] for each in own], axis=0).tolist() for name in self._measures if own},
        }

    def _shown(self, trial: int) -> Demonstration:
        return self._demonstrations[trial % len(self._demonstrations)]

    def _most_steps(self, shown: Demonstration) -> int:
        config = self._setup.config
        steps = int(config.length_factor * shown.length)
        return min(steps, config.most_steps or steps)

    def _demonstrate(self, path: str) -> Demonstration:
        setup, config = self._setup, self._setup.config
        request = CreateSessionRequest(
            setup.task.name,
            num_envs=1,
            seed=derive_seed(config.demonstration_seed, setup.task.skills.index(path)),
            height=self._policy.height,
            width=self._policy.width,
            privileged=True,
            conditions=config.demonstration_conditions,
        )
        return demonstrate(
            setup.sim, setup.task, request, path, setup.interrupt, cameras=self._cameras, every=config.every
        )


def _not_switched(policy: str) -> InvalidInput:
    return InvalidInput(
        f"Landmarks are switched for a policy that follows goal images; {policy} does not.",
        field="config.switching",
        hint="Leave it out, or name a model of the imitation service that follows them.",
    )


def _at_landmarks(
    truth: TruthSession, judge: str, episodes: Sequence[Episode], shown: Sequence[Demonstration]
) -> list[Flags]:
    """Returns whether each robot was at each of its N landmarks, bool (N, T + 1) per episode."""
    states = [each.states for each, own in zip(episodes, shown, strict=True) for _ in own.steps]
    there = [
        np.broadcast_to(landmark, each.states.shape)
        for each, own in zip(episodes, shown, strict=True)
        for landmark in own.states
    ]
    held = iter(truth.holds(judge, states, there))
    return [np.stack([next(held) for _ in own.steps]) for own in shown]


def _cut(episode: Episode, steps: int) -> Episode:
    """Returns the first timesteps of an episode."""
    index, confidence = episode.goal_index, episode.goal_confidence
    return replace(
        episode,
        actions=episode.actions[:steps],
        states=episode.states[: steps + 1],
        goal_index=None if index is None else index[:steps],
        goal_confidence=None if confidence is None else confidence[:steps],
    )


def _figure(name: str, judge: str) -> str:
    """Returns the name of a figure by a predicate, such as `completion.32` by `at-landmark/32`."""
    return f"{name}{judge.removeprefix(AT_LANDMARK).replace('/', '.')}"


def _figures(values: Sequence[Mapping[str, Any]], judges: Sequence[str], *, seed: int) -> dict[str, Figure]:
    """Returns medians with their means beside, shares and means, and the quality of the policy's flag."""
    figures = {}
    for name in [_figure(each, judge) for judge in judges for each in ("completion", "efficiency")]:
        numbers = [each[name] for each in values]
        figures[name] = median_figure(numbers)
        figures[f"{name}.mean"] = mean_figure(numbers, seed=seed)
    stopped = [_figure("stopped", judge) for judge in judges]
    failed = [f"failed.{each}" for each in FAILURES]
    for name in ("success", "contact", "recognized", "ended", *stopped, *failed, "steps", "farthest_at"):
        if name in values[0]:
            figures[name] = mean_figure([float(each[name]) for each in values], seed=seed)
    if "confidence" in values[0]:
        confidence, at = (list(chain.from_iterable(each[name] for each in values)) for name in _FLAGGED)
        figures |= {f"visited.{name}": figure for name, figure in flag_figures(confidence, at).items()}
    return figures


FORM = Form(DemonstrationsConfig, DemonstrationsEvaluation, check_policy)
