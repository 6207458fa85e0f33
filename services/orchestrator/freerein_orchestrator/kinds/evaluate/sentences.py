"""Form `sentences`: a policy that is told in words what to do, told every goal text in every task.

All goal texts are told in episodes from the same starts. The word-blind baseline is the one text that, told in all
tasks, earns most: what a policy earns that ignores its goal.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from freerein.clients.tasks import find_task
from freerein.errors import InvalidInput
from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle
from freerein_orchestrator.kinds.evaluate.form import Form, Result, Setup, Trial, mean_figure
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_no_goal, check_policy, find_policy


@dataclass(frozen=True, kw_only=True)
class SentencesConfig(PolicyConfig):
    """Configuration of the form `sentences`.

    Attributes:
        form: The form.
        other_tasks: More tasks, each with a goal text of its own.
        other_texts: Goal texts that the policy is told beside those of the tasks.
    """

    form: Literal["sentences"] = "sentences"
    other_tasks: tuple[str, ...] = ()
    other_texts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        check_no_goal(self)


class SentencesEvaluation:
    """Runs whole episodes of every task and every goal text.

    Attributes:
        subject: The policy, the tasks, and the goal texts: those of the tasks first, in order.
    """

    def __init__(self, setup: Setup[SentencesConfig]) -> None:
        config, policy = setup.config, find_policy(setup)
        if policy.description["policy"] != "imitation":
            raise InvalidInput(
                "The form sentences needs a policy that takes goal texts; this one takes none.",
                field="config.policy",
                hint="Name a language policy of the imitation service.",
            )
        others = [find_task(setup.sim, name, field="config.other_tasks") for name in config.other_tasks]
        tasks = [setup.task, *others]
        self._own = [task.goal_text for task in tasks]
        self._texts = list(dict.fromkeys([*self._own, *config.other_texts]))
        if len(self._texts) < 2 or not all(self._texts):
            raise InvalidInput(
                "The form sentences needs tasks with goal texts, and at least two texts in all; got "
                f"{sum(map(bool, self._texts))}.",
                field="config.other_texts",
                hint="Add a task, or a text that the policy could confuse with the task's.",
            )
        self._setup = setup
        pinned = replace(setup, subject=policy.description)
        self._tasks = [_Task(task.name, find_policy(replace(pinned, task=task))) for task in tasks]
        self.subject: dict[str, Any] = {
            **policy.description,
            "tasks": [task.name for task in tasks],
            "goal_texts": self._texts,
        }

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`: each holds the return in each task, told each text."""
        returns = np.array([[self._returns(task, text, first, count) for text in self._texts] for task in self._tasks])
        own = self._own_texts(returns).mean(axis=0)
        return [
            Trial({"returns": returns[..., trial].tolist(), "own_text_return": float(own[trial])})
            for trial in range(count)
        ]

    def _returns(self, task: "_Task", text: str, first: int, count: int) -> list[float]:
        setup, policy = self._setup, task.policy
        request = setup.session(count, first, height=policy.height, width=policy.width)
        episodes = run_episodes(
            setup.sim, replace(request, task=task.name), policy, setup.interrupt, goals=[Goal(text=text)] * count
        )
        return [float(each.rewards.sum()) for each in episodes]

    def _own_texts(self, returns: Any) -> Any:
        """Returns the rows of each task told its own text: (tasks, N) of (tasks, texts, N)."""
        return np.stack([returns[task, self._texts.index(text)] for task, text in enumerate(self._own)])

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the return told the own texts, the gain over the best constant text, and the return of each text."""
        returns = np.stack([np.array(trial.values["returns"]) for trial in trials], axis=-1)  # (tasks, texts, N)
        seed, own = self._setup.config.seed, self._own_texts(returns).mean(axis=0)
        constant = returns.mean(axis=0)  # (texts, N)
        best = int(constant.mean(axis=1).argmax())
        figures = {
            "own_text_return": mean_figure(own, seed=seed, baseline=float(constant[best].mean())),
            "gain_by_words": mean_figure(own - constant[best], seed=seed, baseline=0.0),
        }
        told = [
            {"task": task.name, "goal_text": text, "return_mean": asdict(mean_figure(returns[row, column], seed=seed))}
            for row, task in enumerate(self._tasks)
            for column, text in enumerate(self._texts)
        ]
        counts = {"episodes": returns.size, "trials": len(trials)}
        return Result(figures, counts, {"word_blind_text": self._texts[best], "told": told})


@dataclass(frozen=True, eq=False)
class _Task:
    """A task by name, and the policy in it."""

    name: str
    policy: PolicyHandle


FORM = Form(SentencesConfig, SentencesEvaluation, check_policy)
