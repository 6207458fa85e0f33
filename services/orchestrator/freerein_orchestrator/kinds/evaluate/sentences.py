"""Form `sentences`: evaluates a language-conditioned policy on every goal text in every task.

Episodes of all goal texts have the same starts. The word-blind baseline is the highest return of one text in all
tasks: an upper bound for policies that ignore their goal. The confusion matrix has, for each text, the tasks whose goal
held at the end. Where the policy says whether its goal is reached, its confidence is compared with whether the goal
held, in each task conditioned on its own text.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.clients.tasks import find_task
from freerein.errors import InvalidInput
from freerein.types.common import Goal
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle
from freerein_orchestrator.kinds.evaluate.form import (
    FILMED,
    Figure,
    Form,
    Result,
    Setup,
    Trial,
    mean_figure,
    ratio_figure,
)
from freerein_orchestrator.kinds.evaluate.goal_flags import flag_figures, judged
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_no_goal, check_policy, find_policy

_FLAGS = ("confidence", "holds")

Values = npt.NDArray[np.float64]
"""float64 (tasks, texts, N): a value of each of N trials."""


@dataclass(frozen=True, kw_only=True)
class SentencesConfig(PolicyConfig):
    """Configuration of the form `sentences`.

    Attributes:
        form: The form.
        other_tasks: More tasks, each with a goal text of its own.
        other_texts: Goal texts that the policy is conditioned on beside those of the tasks.
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
        """Returns trials `first` to `first + count`: each holds return and success by task and text."""
        episodes = [[self._episodes(task, text, first, count) for text in self._texts] for task in self._tasks]
        trials = []
        for trial in range(count):
            ended = [[each[trial] for each in texts] for texts in episodes]
            returns = np.array([[float(each.rewards.sum()) for each in texts] for texts in ended])
            successes = [[each.success for each in texts] for texts in ended]
            own = float(self._own_texts(returns).mean())
            flags = [judged(each[self._texts.index(text)]) for each, text in zip(ended, self._own, strict=True)]
            confidence, holds = (list(chain.from_iterable(each)) for each in zip(*flags, strict=True))
            values = {
                "returns": returns.tolist(),
                "successes": successes,
                "own_text_return": own,
                "confidence": confidence,
                "holds": holds,
            }
            trials.append(Trial(values, {FILMED: ended[0][0].actions}))
        return trials

    def _episodes(self, task: "_Task", text: str, first: int, count: int) -> Sequence[Episode]:
        setup, policy = self._setup, task.policy
        request = setup.session(count, first, height=policy.height, width=policy.width)
        goals = [Goal(text=text)] * count
        return run_episodes(setup.sim, replace(request, task=task.name), policy, setup.interrupt, goals=goals)

    def _own_texts(self, values: Values) -> Values:
        """Returns the values of each task with its own text: (tasks, ...) of (tasks, texts, ...)."""
        return np.stack([values[task, self._texts.index(text)] for task, text in enumerate(self._own)])

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures, the return of each text in each task, and the confusion matrix."""
        returns, successes = (
            np.stack([np.array(trial.values[name], np.float64) for trial in trials], axis=-1)  # (tasks, texts, N)
            for name in ("returns", "successes")
        )
        seed, own = self._setup.config.seed, self._own_texts(returns).mean(axis=0)
        constant = returns.mean(axis=0)  # (texts, N)
        best = int(constant.mean(axis=1).argmax())
        word_blind = mean_figure(constant[best], seed=seed)
        figures = {
            "own_text_return": mean_figure(own, seed=seed, baseline=word_blind.value),
            "word_blind": word_blind,
            "gain_by_words": mean_figure(own - constant[best], seed=seed, baseline=0.0),
            **told_is_done(successes, [self._texts.index(text) for text in self._own], seed=seed),
            **flag_figures(*(list(chain.from_iterable(each.values[name] for each in trials)) for name in _FLAGS)),
        }
        by_task_and_text = [
            {"task": task.name, "goal_text": text, "return_mean": asdict(mean_figure(returns[row, column], seed=seed))}
            for row, task in enumerate(self._tasks)
            for column, text in enumerate(self._texts)
        ]
        confusion = confusion_matrix(successes, tasks=[task.name for task in self._tasks], texts=self._texts)
        details = {"word_blind_text": self._texts[best], "told": by_task_and_text, "confusion": confusion}
        film = self._setup.film(0, trials[0], self._tasks[0].policy)
        return Result(figures, {"episodes": returns.size, "trials": len(trials)}, details, film=film)


def told_is_done(successes: Values, own: Sequence[int], *, seed: int) -> dict[str, Figure]:
    """Returns `told_is_done`: of episodes with a task's own text that end in any task's goal, the share in its own.

    There is no figure where no goal was reached.

    Args:
        successes: float64 (tasks, texts, N), 1 where the goal held at the end of an episode of a task with a text.
        own: For each task, which text is its own.
        seed: Seed of the interval.
    """
    right = np.stack([successes[task, text] for task, text in enumerate(own)]).sum(axis=0)  # (N,)
    any_goal = successes[:, own].sum(axis=(0, 1))  # (N,)
    if not any_goal.any():
        return {}
    return {"told_is_done": ratio_figure(right[:, None], any_goal[:, None], seed=seed, baseline=1 / len(own))}


def confusion_matrix(successes: Values, *, tasks: Sequence[str], texts: Sequence[str]) -> list[dict[str, Any]]:
    """Returns for each text how often the goal of each task held at the end of its episodes, and how often none did.

    Args:
        successes: As of `told_is_done`.
        tasks: Names of the tasks.
        texts: The texts.
    """
    return [
        {
            "goal_text": text,
            "done": dict(zip(tasks, successes[:, column].mean(axis=1).tolist(), strict=True)),
            "none": float((successes[:, column].max(axis=0) == 0).mean()),
        }
        for column, text in enumerate(texts)
    ]


@dataclass(frozen=True, eq=False)
class _Task:
    """A task by name, and the policy in it."""

    name: str
    policy: PolicyHandle


FORM = Form(SentencesConfig, SentencesEvaluation, check_policy)
