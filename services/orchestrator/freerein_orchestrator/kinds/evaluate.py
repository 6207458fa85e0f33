"""Kind `evaluate`: what a policy earns in a task by the oracle's reward, which only an evaluation may see.

<folder>/checkpoints/episodes.json   what the episodes so far came to, and who acted
         artifacts/result.json       what came of all
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import torch

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput
from freerein.learning.config import bounded, parse
from freerein.types.common import Goal, ModelRef
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator import actors, policy_artifact
from freerein_orchestrator.actors import FromRun, Pilot
from freerein_orchestrator.drive import Episode, find_task, play, seed_of
from freerein_orchestrator.estimates import estimate
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.patience import Patience, Stopped
from freerein_orchestrator.policy_artifact import Policy
from freerein_orchestrator.served_rollouts import persist
from freerein_orchestrator.work import Work

RESULT = "result.json"
_TORCH_THREADS = 1


@dataclass(frozen=True)
class EvaluateConfig:
    """What to evaluate.

    Attributes:
        task: The task's name.
        policy: "random", or an object: see `actors.FromRun` and `actors.FromModel`. A model of the imitation service
            that is not told what to do is told the task's goal text.
        episodes: How many.
        num_envs: Environments that step together.
        seed: Of every episode.
    """

    task: str
    policy: Literal["random"] | dict[str, Any]
    episodes: int = bounded(50, least=1, most=100_000)
    num_envs: int = bounded(10, least=1, most=64)
    seed: int = bounded(0, least=0, most=2**31 - 1)


def resolve(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the whole configuration."""
    config = parse(EvaluateConfig, values)
    choice = actors.choose(config.policy)
    return {**asdict(config), "policy": choice if isinstance(choice, str) else asdict(choice)}


def steps(config: Mapping[str, Any]) -> int:
    """Returns the number of episodes."""
    return int(config["episodes"])


def run(work: Work) -> bool:
    """Plays the episodes, a round of `num_envs` after the other; killed, it goes on after the last whole round.

    Raises:
        InvalidInput: There is no such policy, or it is none for this task.
        ServiceError: A service refuses.
    """
    config, evaluation = parse(EvaluateConfig, work.config), _Evaluation(work)
    patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
    torch.set_num_threads(_TORCH_THREADS)
    try:
        sim = work.client("sim")
        task = patience.ask(lambda: find_task(sim, config.task))
        pilot = patience.ask(lambda: _pilot(config, task, work, evaluation.told))
        while len(evaluation.outcomes) < config.episodes:
            request = _round(config, pilot, begun=len(evaluation.outcomes))
            evaluation.add(pilot, persist(partial(play, sim, request, pilot, patience.interrupt), patience))
    except Stopped:
        return False
    evaluation.conclude(task)
    return True


def check(work: Work, earlier: Collection[str]) -> None:
    """Refuses a run that is not there, or has no policy."""
    choice = actors.choose(work.config["policy"])
    if isinstance(choice, FromRun) and choice.run not in earlier:
        _made_by(work, choice)


KIND = Kind(resolve, steps, run, check)


@dataclass(frozen=True)
class Outcome:
    """What an episode came to.

    Attributes:
        total: Sum of the oracle's rewards.
        length: Timesteps.
        is_success: Whether the goal holds in the end.
    """

    total: float
    length: int
    is_success: bool


class _Evaluation:
    """What the episodes came to so far, on disk.

    Attributes:
        told: Who acts, of the attempts before; empty in the first.
        outcomes: Of the episodes, in order.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._path = work.folder / "checkpoints" / "episodes.json"
        before = json.loads(self._path.read_bytes()) if self._path.is_file() else {"told": {}, "outcomes": []}
        self.told: dict[str, Any] = before["told"]
        self.outcomes = [Outcome(**each) for each in before["outcomes"]]
        self._curve = work.curve(last_step=0)
        self._show(range(len(self.outcomes)))

    def add(self, pilot: Pilot, episodes: Sequence[Episode]) -> None:
        """Adds a round of episodes, durably."""
        begun = len(self.outcomes)
        self.told = pilot.told
        self.outcomes += [Outcome(float(each.rewards.sum()), len(each.rewards), each.is_success) for each in episodes]
        document = {"told": self.told, "outcomes": [asdict(outcome) for outcome in self.outcomes]}
        write_atomic(self._path, json.dumps(document).encode())
        self._show(range(begun, len(self.outcomes)))

    def conclude(self, task: Task) -> None:
        """Writes the result."""
        result = {
            "task": task.name,
            "goal_text": task.goal_text,
            "privileged": True,
            **{name: self._work.config[name] for name in ("episodes", "num_envs", "seed")},
            **self.told,
            **self._figures(),
            "returns": [outcome.total for outcome in self.outcomes],
            "lengths": [outcome.length for outcome in self.outcomes],
            "successes": [outcome.is_success for outcome in self.outcomes],
        }
        write_atomic(self._work.artifacts / RESULT, json.dumps(result, indent=2).encode() + b"\n")

    def _show(self, indices: range) -> None:
        for index in indices:
            outcome = self.outcomes[index]
            row = {
                "episode_return": outcome.total,
                "episode_length": outcome.length,
                "success": float(outcome.is_success),
            }
            is_last = index + 1 == self._work.config["episodes"]
            self._curve.append(index + 1, row | (self._figures() if is_last else {}))

    def _figures(self) -> dict[str, float]:
        rng = np.random.default_rng(self._work.config["seed"])
        earned = estimate([outcome.total for outcome in self.outcomes], rng=rng)
        return {
            "return_mean": earned.mean,
            "return_low": earned.low,
            "return_high": earned.high,
            "success_rate": float(np.mean([outcome.is_success for outcome in self.outcomes])),
        }


def _round(config: EvaluateConfig, pilot: Pilot, *, begun: int) -> CreateSessionRequest:
    return CreateSessionRequest(
        config.task,
        num_envs=min(config.num_envs, config.episodes - begun),
        seed=seed_of(config.seed, begun),
        height=pilot.height,
        width=pilot.width,
        privileged=True,
    )


def _pilot(config: EvaluateConfig, task: Task, work: Work, told: Mapping[str, Any]) -> Pilot:
    """Returns who acts: the same version of a model as in the attempts before."""
    choice = actors.choose(config.policy)
    if isinstance(choice, str):
        return actors.by_chance(task.action)
    if isinstance(choice, FromRun):
        made, goal = _made_by(work, choice), Goal(text=choice.goal_text)
        if isinstance(made, Policy):
            return actors.of_policy(made, task, is_stochastic=choice.is_stochastic)
    else:
        made, goal = ModelRef(choice.model, choice.version), Goal(recipe=choice.recipe, text=choice.goal_text)
    model = ModelRef(**told["model"]) if told else made
    if not (goal.text or goal.recipe):
        goal = Goal(text=task.goal_text)
    return actors.of_model(work.client("imitation"), model, goal, task, closing=work.closing)


def _made_by(work: Work, choice: FromRun) -> Policy | ModelRef:
    """Returns the policy, or the model of the imitation service, that a run has made.

    Raises:
        InvalidInput: There is no such run, or it has made neither.
    """
    folder = work.run_folder(choice.run)
    if (folder / "artifacts" / policy_artifact.NAMES.card).is_file():
        return policy_artifact.load(folder / "artifacts", device=work.device)
    if (folder / "model.json").is_file():
        return ModelRef(**json.loads((folder / "model.json").read_bytes()))
    raise InvalidInput(
        "A run whose policy is to act must have made one; this one has not.",
        field="config.policy.run",
        hint="Name a ppo run that has succeeded, or one that made a model of the imitation service.",
    )
