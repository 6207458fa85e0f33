"""Kind `evaluate`: the return of a policy in a task by the oracle's reward, which only an evaluation may see.

<folder>/checkpoints/episodes.json   the episodes so far, and the policy
         artifacts/result.json       the result
"""

import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
import torch

from freerein import metrics
from freerein.atomic_files import write_atomic
from freerein.clients.tasks import find_task
from freerein.errors import InvalidInput
from freerein.learning.config import bounded, parse
from freerein.types.common import Goal, ModelRef
from freerein.types.sim import CreateSessionRequest, Task
from freerein_orchestrator.envs.episodes import Episode, derive_seed, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, random_policy, served_policy, stored_policy
from freerein_orchestrator.envs.reward_fns import zero_reward
from freerein_orchestrator.envs.vector_env import RemoteVectorEnv
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.kind import Kind
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.policy_files import NAMES, StoredPolicy, load_policy
from freerein_orchestrator.rl.state import calibrate, init_network, network_spec

RESULT = "result.json"
_TORCH_THREADS = 1
_FIELD = "config.policy"


@dataclass(frozen=True)
class RunPolicy:
    """The policy that a run has made.

    Attributes:
        run: A run's id, or an earlier step of the pipeline; it has trained a policy, or fitted an imitation model.
        goal_text: The goal of such a model.
        stochastic: Whether actions of a ppo run's policy are sampled; else the most likely one is taken.
    """

    run: str
    goal_text: str = ""
    stochastic: bool = False


@dataclass(frozen=True)
class ModelPolicy:
    """A model of the imitation service.

    Attributes:
        model: Its name.
        version: Its version; empty for the active one.
        goal_text: Its goal in words.
        recipe: Or the skills to execute in order.
    """

    model: str
    version: str = ""
    goal_text: str = ""
    recipe: tuple[str, ...] = ()


@dataclass(frozen=True)
class StoredModelPolicy:
    """A policy among the models of the orchestrator.

    Attributes:
        stored: Its name.
        version: Its version; empty for the active one.
        stochastic: Whether its actions are sampled; else the most likely one is taken.
    """

    stored: str
    version: str = ""
    stochastic: bool = False


@dataclass(frozen=True)
class UntrainedPolicy:
    """The policy that a ppo run of default size starts with.

    Attributes:
        untrained: Seed of its weights.
        stochastic: Whether its actions are sampled; else the most likely one is taken.
    """

    untrained: int = bounded(0, least=0, most=2**31 - 1)
    stochastic: bool = True


PolicyChoice: TypeAlias = Literal["random"] | RunPolicy | ModelPolicy | StoredModelPolicy | UntrainedPolicy
_CHOICES: Mapping[str, Any] = {
    "run": RunPolicy,
    "model": ModelPolicy,
    "stored": StoredModelPolicy,
    "untrained": UntrainedPolicy,
}


@dataclass(frozen=True)
class EvaluateConfig:
    """Configuration of a run of kind `evaluate`.

    Attributes:
        task: The task's name.
        policy: "random", or an object with `run`, `model`, `stored` or `untrained`. A model of the imitation service
            gets the task's goal text unless it is given a goal.
        episodes: Number of episodes.
        num_envs: Number of parallel environments.
        seed: Seed of every episode.
    """

    task: str
    policy: Literal["random"] | dict[str, Any]
    episodes: int = bounded(50, least=1, most=100_000)
    num_envs: int = bounded(10, least=1, most=64)
    seed: int = bounded(0, least=0, most=2**31 - 1)

    def __post_init__(self) -> None:
        if isinstance(self.policy, dict):
            object.__setattr__(self, "policy", asdict(_parse_policy(self.policy)))  # defaults filled in

    @property
    def choice(self) -> PolicyChoice:
        """The policy."""
        return _parse_policy(self.policy) if isinstance(self.policy, dict) else self.policy


def _parse_policy(values: Mapping[str, Any]) -> RunPolicy | ModelPolicy | StoredModelPolicy | UntrainedPolicy:
    named = [name for name in _CHOICES if name in values]
    if len(named) != 1:
        raise InvalidInput(
            f'`policy` must be "random", or hold one of {", ".join(_CHOICES)}; it holds {len(named)} of them.',
            field=_FIELD,
            hint='{"run": "<id>"} is a policy of PPO, {"model": "default", "goal_text": "..."} one of imitation.',
        )
    choice: RunPolicy | ModelPolicy | StoredModelPolicy | UntrainedPolicy = parse(_CHOICES[named[0]], values)
    return choice


def run(context: RunContext, config: EvaluateConfig) -> None:
    """Runs the episodes in rounds of `num_envs`; a killed run continues after the last whole round.

    Raises:
        Stopped: The run is to stop.
        InvalidInput: There is no such policy or task, or they do not fit.
        ServiceError: A service refuses.
    """
    torch.set_num_threads(_TORCH_THREADS)
    evaluation, retry, sim = _Evaluation(context, config), context.retry(), context.client("sim")
    task = retry.call(lambda: find_task(sim, config.task))
    policy = retry.call(lambda: _policy(context, config, task, evaluation.policy))
    while (done := len(evaluation.outcomes)) < config.episodes:
        request = CreateSessionRequest(
            config.task,
            num_envs=min(config.num_envs, config.episodes - done),
            seed=derive_seed(config.seed, done),
            height=policy.height,
            width=policy.width,
            privileged=True,
        )
        evaluation.add(policy, retry.call(partial(run_episodes, sim, request, policy, retry.interrupt)))
    evaluation.write_result(task)


def check(config: EvaluateConfig, store: PolicyStore, earlier: Collection[str]) -> None:
    """Checks that the policy of a run, or the stored one, exists or will."""
    match config.choice:
        case RunPolicy(run=name) if name not in earlier:
            _made_by_run(store, name, device="cpu")
        case StoredModelPolicy(stored=name, version=version):
            store.model_folder(ModelRef(name, version), field=_FIELD)


KIND = Kind(partial(parse, EvaluateConfig), steps=lambda config: config.episodes, run=run, check=check)


@dataclass(frozen=True)
class EpisodeOutcome:
    """The outcome of an episode.

    Attributes:
        episode_return: Return by the oracle's reward.
        length: Its timesteps.
        success: Whether the goal holds at the end.
    """

    episode_return: float
    length: int
    success: bool


class _Evaluation:
    """The episodes so far, on disk.

    Attributes:
        policy: Description of the policy, of earlier attempts; empty in the first.
        outcomes: Of the episodes, in order.
    """

    def __init__(self, context: RunContext, config: EvaluateConfig) -> None:
        self._context = context
        self._config = config
        self._path = context.folder / "checkpoints" / "episodes.json"
        saved = json.loads(self._path.read_bytes()) if self._path.is_file() else {"policy": {}, "outcomes": []}
        self.policy: dict[str, Any] = saved["policy"]
        self.outcomes = [EpisodeOutcome(**each) for each in saved["outcomes"]]
        self._metrics = context.metrics_logger(0)
        self._log(range(len(self.outcomes)))

    def add(self, policy: PolicyHandle, episodes: Sequence[Episode]) -> None:
        """Adds a round of episodes, durably."""
        first = len(self.outcomes)
        self.policy = policy.description
        self.outcomes += [
            EpisodeOutcome(float(each.rewards.sum()), len(each.rewards), each.success) for each in episodes
        ]
        document = {"policy": self.policy, "outcomes": [asdict(outcome) for outcome in self.outcomes]}
        write_atomic(self._path, json.dumps(document).encode())
        self._log(range(first, len(self.outcomes)))

    def write_result(self, task: Task) -> None:
        """Writes the result."""
        result = {
            "task": task.name,
            "goal_text": task.goal_text,
            "privileged": True,
            **{name: getattr(self._config, name) for name in ("episodes", "num_envs", "seed")},
            **self.policy,
            **self._figures(),
            "returns": [outcome.episode_return for outcome in self.outcomes],
            "lengths": [outcome.length for outcome in self.outcomes],
            "successes": [outcome.success for outcome in self.outcomes],
        }
        write_atomic(self._context.artifacts / RESULT, json.dumps(result, indent=2).encode() + b"\n")

    def _log(self, indices: range) -> None:
        for index in indices:
            outcome = self.outcomes[index]
            row = {
                "episode_return": outcome.episode_return,
                "episode_length": outcome.length,
                "success": float(outcome.success),
            }
            is_last = index + 1 == self._config.episodes
            self._metrics.append(index + 1, row | (self._figures() if is_last else {}))

    def _figures(self) -> dict[str, float]:
        returns = [outcome.episode_return for outcome in self.outcomes]
        low, high = metrics.mean_interval(returns, rng=np.random.default_rng(self._config.seed))
        return {
            "return_mean": float(np.mean(returns)),
            "return_low": low,
            "return_high": high,
            "success_rate": float(np.mean([outcome.success for outcome in self.outcomes])),
        }


def _policy(context: RunContext, config: EvaluateConfig, task: Task, pinned: Mapping[str, Any]) -> PolicyHandle:
    """Returns the policy: the same version of a model as in earlier attempts."""
    store = context.policies
    match config.choice:
        case RunPolicy(name, goal_text, stochastic):
            made, goal = _made_by_run(store, name, device=context.device), Goal(text=goal_text)
            if isinstance(made, StoredPolicy):
                return stored_policy(made, task, stochastic=stochastic)
        case ModelPolicy(name, version, goal_text, recipe):
            made, goal = ModelRef(name, version), Goal(recipe=recipe, text=goal_text)
        case StoredModelPolicy(name, version, stochastic):
            asked = ModelRef(name, version)
            ref = ModelRef(**pinned["model"]) if pinned else store.resolve_model(asked, field=_FIELD)
            made = load_policy(store.model_folder(ref, field=_FIELD), device=context.device)
            return stored_policy(made, task, stochastic=stochastic, model=ref)
        case UntrainedPolicy(seed, stochastic):
            return stored_policy(_untrained(context, task, seed), task, stochastic=stochastic)
        case _:
            return random_policy(task.action)
    model = ModelRef(**pinned["model"]) if pinned else made
    if not (goal.text or goal.recipe):
        goal = Goal(text=task.goal_text)
    return served_policy(context.client("imitation"), model, goal, task, closing=context.closing)


def _made_by_run(store: PolicyStore, name: str, *, device: str) -> StoredPolicy | ModelRef:
    """Returns the policy, or the model of the imitation service, that a run has made.

    Raises:
        InvalidInput: There is no such run, or it has made neither.
    """
    folder = store.run_folder(name)
    if (folder / "artifacts" / NAMES.card).is_file():
        return load_policy(folder / "artifacts", device=device)
    if (folder / "model.json").is_file():
        return ModelRef(**json.loads((folder / "model.json").read_bytes()))
    raise InvalidInput(
        "The run must have made a policy; this one has not.",
        field="config.policy.run",
        hint="Name a ppo run that has succeeded, or one that made a model of the imitation service.",
    )


def _untrained(context: RunContext, task: Task, seed: int) -> StoredPolicy:
    """Returns a network of default size as a ppo run on the task's first camera initialises it."""
    camera, config = task.cameras[0], PPOConfig(seed=seed)
    spec = network_spec(
        config,
        observation=(camera.height, camera.width, camera.channels),
        action_size=task.action.size,
        action_choices=task.action.choices,
    )
    generator = torch.Generator().manual_seed(seed)
    network = init_network(spec, generator)
    request = CreateSessionRequest(task.name, num_envs=config.num_envs, seed=seed)
    with closing(RemoteVectorEnv([context.client("sim")], request, camera=camera.name, reward_fn=zero_reward)) as envs:
        calibrate(network, envs, generator)
    return StoredPolicy(network.eval(), {"camera": camera.name, "sha256": ""})
