"""Form `returns`: the return of a policy by the oracle's reward."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import run_episodes
from freerein_orchestrator.kinds.evaluate.form import Form, Result, Setup, Trial, mean_figure
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_policy, find_policy


@dataclass(frozen=True, kw_only=True)
class ReturnsConfig(PolicyConfig):
    """Configuration of the form `returns`. A model of imitation gets the task's goal text unless it is given a goal.

    Attributes:
        form: The form.
    """

    form: Literal["returns"] = "returns"


class ReturnsEvaluation:
    """Runs whole episodes.

    Attributes:
        subject: The policy, and its goal.
    """

    def __init__(self, setup: Setup[ReturnsConfig]) -> None:
        self._setup = setup
        self._policy = find_policy(setup)
        goal = setup.config.goal
        self._goal = goal if goal.text or goal.recipe else Goal(text=setup.task.goal_text)
        self.subject: dict[str, Any] = {"goal_text": setup.task.goal_text, **self._policy.description}
        if self._policy.description["policy"] == "imitation":
            self.subject |= {"goal_text": self._goal.text, "recipe": list(self._goal.recipe)}

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        setup, policy = self._setup, self._policy
        episodes = run_episodes(
            setup.sim,
            setup.session(count, first, height=policy.height, width=policy.width),
            policy,
            setup.interrupt,
            goals=[self._goal] * count,
        )
        return [
            Trial(
                {
                    "episode_return": float(each.rewards.sum()),
                    "episode_length": len(each.rewards),
                    "success": each.success,
                }
            )
            for each in episodes
        ]

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials."""
        names = {"returns": "episode_return", "lengths": "episode_length", "successes": "success"}
        lists = {name: [trial.values[key] for trial in trials] for name, key in names.items()}
        seed = self._setup.config.seed
        return Result(
            {
                "return_mean": mean_figure(lists["returns"], seed=seed),
                "success_rate": mean_figure(lists["successes"], seed=seed),
            },
            {"episodes": len(trials)},
            lists,
        )


FORM = Form(ReturnsConfig, ReturnsEvaluation, check_policy)
