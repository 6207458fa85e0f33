"""Form `returns`: the return of a policy by the oracle's reward; against a baseline in the same episodes, the gain.

Where the task has an expert and a goal, the expert's return in the same episodes stands beside it, as the ceiling.
Where the task has predicates `start/WHAT`, figures are also split by them: `return_mean.WHAT`, `return_mean.not-WHAT`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from freerein.errors import InvalidInput
from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, expert_policy
from freerein_orchestrator.envs.truth import truth_session
from freerein_orchestrator.kinds.evaluate.form import FILMED, Figure, Form, Result, Setup, Trial, mean_figure
from freerein_orchestrator.kinds.evaluate.policies import (
    PolicyChoice,
    PolicyConfig,
    check_choice,
    check_policy,
    find_policy,
    goal_of,
    parse_policy,
)
from freerein_orchestrator.kinds.policy_store import PolicyStore

_START = "start/"
"""Predicates of these names say how an episode began."""

_SPLIT = {
    "return_mean": "episode_return",
    "success_rate": "success",
    "baseline_return_mean": "baseline_return",
    "expert_return_mean": "expert_return",
}
"""Figures that are split by the start, and the key of their numbers in a trial."""


@dataclass(frozen=True, kw_only=True)
class ReturnsConfig(PolicyConfig):
    """Configuration of the form `returns`. A model of imitation gets the task's goal text unless it is given a goal.

    Attributes:
        form: The form.
        baseline: A policy that runs the same episodes from the same starts, named as `policy` is; or `none`.
    """

    form: Literal["returns"] = "returns"
    baseline: Literal["none", "random", "expert"] | dict[str, Any] = "none"

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.baseline, dict):
            object.__setattr__(self, "baseline", asdict(parse_policy(self.baseline)))  # defaults filled in

    @property
    def baseline_choice(self) -> PolicyChoice | None:
        """The baseline."""
        if isinstance(self.baseline, dict):
            return parse_policy(self.baseline)
        return None if self.baseline == "none" else self.baseline


class ReturnsEvaluation:
    """Runs whole episodes.

    Attributes:
        subject: The policy, and its goal; likewise of the baseline, if there is one.
    """

    def __init__(self, setup: Setup[ReturnsConfig]) -> None:
        self._setup = setup
        config, goal_text = setup.config, setup.task.goal_text
        if setup.task.reward_free:
            raise InvalidInput(
                f"The form returns needs a task with a reward; {setup.task.name} is reward-free.",
                field="config.task",
                hint="Choose another form, such as recipes, or demonstrations; or a task with a goal.",
            )
        self._policy = _GivenPolicy(find_policy(setup), goal_of(config.choice), goal_text)
        self._baseline: _GivenPolicy | None = None
        self.subject: dict[str, Any] = {"goal_text": goal_text, **self._policy.description}
        if (choice := config.baseline_choice) is not None:
            pinned = replace(setup, subject=setup.subject.get("baseline", {}))
            self._baseline = _GivenPolicy(find_policy(pinned, choice), goal_of(choice), goal_text)
            self.subject["baseline"] = self._baseline.description
        self._expert: _GivenPolicy | None = None
        if setup.task.has_expert and goal_text and "expert" not in (config.policy, config.baseline):
            self._expert = _GivenPolicy(expert_policy(setup.sim, setup.task), Goal(), goal_text)
        self._starts = [each.name for each in setup.task.predicates if each.name.startswith(_START)]

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        episodes = self._episodes(self._policy, first, count)
        values: list[dict[str, Any]] = [
            {
                "episode_return": float(each.rewards.sum()),
                "episode_length": len(each.rewards),
                "success": each.success,
                "starts": starts,
            }
            for each, starts in zip(episodes, self._starts_of(episodes), strict=True)
        ]
        for key, policy in (("baseline_return", self._baseline), ("expert_return", self._expert)):
            if policy is not None:
                for own, each in zip(values, self._episodes(policy, first, count), strict=True):
                    own[key] = float(each.rewards.sum())
        return [
            Trial(each | self._expert_return(each), {FILMED: episode.actions})
            for each, episode in zip(values, episodes, strict=True)
        ]

    def _expert_return(self, values: Mapping[str, Any]) -> dict[str, float]:
        """Returns the expert's return where the policy or the baseline is the expert, and the task has a goal."""
        config = self._setup.config
        if not self._setup.task.goal_text or "expert" not in (config.policy, config.baseline):
            return {}
        return {"expert_return": values["episode_return" if config.policy == "expert" else "baseline_return"]}

    def _starts_of(self, episodes: Sequence[Episode]) -> list[dict[str, bool]]:
        """Returns for each episode which predicates of the start hold."""
        if not self._starts:
            return [{} for _ in episodes]
        first_states = [each.states[:1] for each in episodes]
        with truth_session(self._setup.sim, self._setup.task.name) as truth:
            held = {name: truth.holds(name, first_states) for name in self._starts}
        return [{name: bool(flags[i][0]) for name, flags in held.items()} for i in range(len(episodes))]

    def _episodes(self, policy: "_GivenPolicy", first: int, count: int) -> Sequence[Episode]:
        setup, handle = self._setup, policy.handle
        request = setup.session(count, first, height=handle.height, width=handle.width)
        return run_episodes(setup.sim, request, handle, setup.interrupt, goals=[policy.goal] * count)

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials."""
        names = {
            "returns": "episode_return",
            "lengths": "episode_length",
            "successes": "success",
            "baseline_returns": "baseline_return",
            "expert_returns": "expert_return",
        }
        lists = {
            name: [trial.values[key] for trial in trials] for name, key in names.items() if key in trials[0].values
        }
        seed, chance = self._setup.config.seed, lists.get("baseline_returns")
        baseline = None if chance is None else float(np.mean(chance))
        figures = {
            "return_mean": mean_figure(lists["returns"], seed=seed, baseline=baseline),
            "success_rate": mean_figure(lists["successes"], seed=seed),
        }
        if chance is not None:
            figures["baseline_return_mean"] = mean_figure(chance, seed=seed)
            figures["gain"] = mean_figure(np.subtract(lists["returns"], chance).tolist(), seed=seed, baseline=0.0)
        if "expert_returns" in lists:
            figures["expert_return_mean"] = mean_figure(lists["expert_returns"], seed=seed)
        starts = {name: [trial.values["starts"][name] for trial in trials] for name in self._starts}
        figures |= self._split_figures(trials)
        film = self._setup.film(0, trials[0], self._policy.handle)
        return Result(figures, {"episodes": len(trials)}, lists | ({"starts": starts} if starts else {}), film=film)

    def _split_figures(self, trials: Sequence[Trial]) -> dict[str, Figure]:
        """Returns the figures of the trials that began in each way."""
        figures = {}
        for start in self._starts:
            for holds, prefix in ((True, ""), (False, "not-")):
                part = [trial.values for trial in trials if trial.values["starts"][start] is holds]
                for name, key in _SPLIT.items():
                    if part and key in part[0]:
                        split = f"{name}.{prefix}{start.removeprefix(_START)}"
                        figures[split] = mean_figure([each[key] for each in part], seed=self._setup.config.seed)
        return figures


@dataclass(frozen=True, eq=False)
class _GivenPolicy:
    """A policy, the goal that its configuration gives it, and the goal text of the task, which is the default."""

    handle: PolicyHandle
    given: Goal
    goal_text: str

    @property
    def goal(self) -> Goal:
        return self.given if self.given.text or self.given.recipe else Goal(text=self.goal_text)

    @property
    def description(self) -> dict[str, Any]:
        found = self.handle.description
        if found["policy"] == "imitation":
            return {**found, "goal_text": self.goal.text, "recipe": list(self.goal.recipe)}
        return found


def check(config: ReturnsConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks that the policy and the baseline exist or will."""
    check_policy(config, store, earlier)
    if (choice := config.baseline_choice) is not None:
        check_choice(choice, store, earlier)


FORM = Form(ReturnsConfig, ReturnsEvaluation, check)
