"""Form `returns`: the return of a policy by the oracle's reward; against a baseline in the same episodes, the gain."""

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle
from freerein_orchestrator.kinds.evaluate.form import Form, Result, Setup, Trial, mean_figure
from freerein_orchestrator.kinds.evaluate.policies import (
    PolicyChoice,
    PolicyConfig,
    check_choice,
    check_policy,
    find_choice,
    find_policy,
    goal_of,
    parse_policy,
)
from freerein_orchestrator.kinds.policy_store import PolicyStore


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
        self._policy = _GivenPolicy(find_policy(setup), goal_of(config.choice), goal_text)
        self._baseline: _GivenPolicy | None = None
        self.subject: dict[str, Any] = {"goal_text": goal_text, **self._policy.description}
        if (choice := config.baseline_choice) is not None:
            pinned = replace(setup, subject=setup.subject.get("baseline", {}))
            self._baseline = _GivenPolicy(find_choice(pinned, choice), goal_of(choice), goal_text)
            self.subject["baseline"] = self._baseline.description

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        values: list[dict[str, Any]] = [
            {
                "episode_return": float(each.rewards.sum()),
                "episode_length": len(each.rewards),
                "success": each.success,
            }
            for each in self._episodes(self._policy, first, count)
        ]
        if self._baseline is not None:
            for own, each in zip(values, self._episodes(self._baseline, first, count), strict=True):
                own["baseline_return"] = float(each.rewards.sum())
        return [Trial(each) for each in values]

    def _episodes(self, policy: "_GivenPolicy", first: int, count: int) -> Sequence[Episode]:
        setup, handle = self._setup, policy.handle
        request = setup.session(count, first, height=handle.height, width=handle.width)
        return run_episodes(setup.sim, request, handle, setup.interrupt, goals=[policy.goal] * count)

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials."""
        names = {"returns": "episode_return", "lengths": "episode_length", "successes": "success"}
        if self._baseline is not None:
            names["baseline_returns"] = "baseline_return"
        lists = {name: [trial.values[key] for trial in trials] for name, key in names.items()}
        seed, chance = self._setup.config.seed, lists.get("baseline_returns")
        baseline = None if chance is None else float(np.mean(chance))
        figures = {
            "return_mean": mean_figure(lists["returns"], seed=seed, baseline=baseline),
            "success_rate": mean_figure(lists["successes"], seed=seed),
        }
        if chance is not None:
            figures["baseline_return_mean"] = mean_figure(chance, seed=seed)
            figures["gain"] = mean_figure(np.subtract(lists["returns"], chance).tolist(), seed=seed, baseline=0.0)
        return Result(figures, {"episodes": len(trials)}, lists)


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


def check(config: ReturnsConfig, store: PolicyStore, earlier: Collection[str]) -> None:
    """Checks that the policy and the baseline exist or will."""
    check_policy(config, store, earlier)
    if (choice := config.baseline_choice) is not None:
        check_choice(choice, store, earlier)


FORM = Form(ReturnsConfig, ReturnsEvaluation, check)
