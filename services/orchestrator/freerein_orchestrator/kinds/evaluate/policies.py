"""The policies that can be evaluated: how a configuration names one, and how it is found."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, TypeAlias

from freerein.config import parse
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.policy_files import NAMES, StoredPolicy, load_policy
from freerein.types.common import Goal, ModelRef
from freerein_orchestrator.envs.policies import (
    PolicyHandle,
    expert_policy,
    explorer_policy,
    served_policy,
    stored_policy,
)
from freerein_orchestrator.envs.random_policies import uniform_policy
from freerein_orchestrator.kinds.evaluate.form import FormConfig, Setup
from freerein_orchestrator.kinds.policy_store import PolicyStore, has_succeeded, is_step, no_policy

_FIELD = "config.policy"
_RUN_FIELD = "config.policy.run"
_MAKERS = ("ppo", "fit of imitation", "distill")
"""Kinds of steps that make a policy, or a model that acts."""


@dataclass(frozen=True)
class RunPolicy:
    """The policy that a run has made.

    Attributes:
        run: A run's id, or an earlier step of the pipeline; it has succeeded in training a policy, or in fitting an
            imitation model.
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


NamedPolicy: TypeAlias = RunPolicy | ModelPolicy | StoredModelPolicy
PolicyChoice: TypeAlias = Literal["random", "expert"] | NamedPolicy
_CHOICES: Mapping[str, Any] = {
    "run": RunPolicy,
    "model": ModelPolicy,
    "stored": StoredModelPolicy,
}


@dataclass(frozen=True, kw_only=True)
class PolicyConfig(FormConfig):
    """The configuration that all forms that evaluate a policy share.

    Attributes:
        policy: `random`, which is the task's explorer where it has one; the scripted `expert`; or an object with `run`,
            `model` or `stored`.
    """

    policy: Literal["random", "expert"] | dict[str, Any]

    def __post_init__(self) -> None:
        if isinstance(self.policy, dict):
            object.__setattr__(self, "policy", asdict(parse_policy(self.policy)))  # defaults filled in

    @property
    def choice(self) -> PolicyChoice:
        """The policy."""
        return parse_policy(self.policy) if isinstance(self.policy, dict) else self.policy

    @property
    def goal(self) -> Goal:
        """The goal that the policy is given; empty for none."""
        return goal_of(self.choice)


def goal_of(choice: PolicyChoice) -> Goal:
    """Returns the goal that a policy is given; empty for none."""
    return Goal(recipe=getattr(choice, "recipe", ()), text=getattr(choice, "goal_text", ""))


def check_no_goal(config: PolicyConfig) -> None:
    """Checks that the policy is given no goal, for a form that draws the goals.

    Raises:
        InvalidInput: It is.
    """
    if config.goal.text or config.goal.recipe:
        raise InvalidInput(
            "This form draws the goals; `policy` must hold no `goal_text` and no `recipe`.",
            field=_FIELD,
            hint="Leave them out, or choose the form returns.",
        )


def parse_policy(values: Mapping[str, Any]) -> NamedPolicy:
    """Returns the policy that an object names.

    Raises:
        InvalidInput: It names none, or several.
    """
    named = [name for name in _CHOICES if name in values]
    if len(named) != 1:
        raise InvalidInput(
            f'`policy` must be "random" or "expert", or hold one of {", ".join(_CHOICES)}; it holds {len(named)} of '
            "them.",
            field=_FIELD,
            hint='{"run": "<id>"} is a policy of PPO, {"model": "default", "goal_text": "..."} one of imitation.',
        )
    choice: NamedPolicy = parse(_CHOICES[named[0]], values)
    return choice


def check_policy(config: PolicyConfig, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks that the policy of a run, or the stored one, exists or will.

    Raises:
        InvalidInput: It does not, or an earlier step is of a kind that makes none.
    """
    check_choice(config.choice, store, earlier)


def check_choice(choice: PolicyChoice, store: PolicyStore, earlier: Mapping[str, str]) -> None:
    """Checks a policy as `check_policy`."""
    match choice:
        case RunPolicy(run=name):
            if not is_step(name, earlier, _MAKERS, field=_RUN_FIELD):
                _made_by_run(store, name, device="cpu")
        case StoredModelPolicy(stored=name, version=version):
            store.model_folder(ModelRef(name, version), field=_FIELD)


def find_policy(setup: Setup[Any], choice: PolicyChoice | None = None, *, max_steps_per_goal: int = 0) -> PolicyHandle:
    """Returns a policy: the same version of a model as in earlier attempts.

    Args:
        setup: The evaluation's; its `subject` describes the policy as it was in earlier attempts.
        choice: Which policy; None for that of the configuration, a `PolicyConfig`.
        max_steps_per_goal: Steps after which a served model abandons a goal; 0 for its own limit.
    """
    context, task, pinned = setup.context, setup.task, setup.subject.get("model")
    store = context.policies
    match choice or setup.config.choice:
        case RunPolicy(run=name, stochastic=stochastic):
            made = _made_by_run(store, name, device=context.device)
            if isinstance(made, StoredPolicy):
                return stored_policy(made, task, stochastic=stochastic)
        case ModelPolicy(model=name, version=version):
            made = ModelRef(name, version)
        case StoredModelPolicy(stored=name, version=version, stochastic=stochastic):
            asked = ModelRef(name, version)
            ref = ModelRef(**pinned) if pinned else store.resolve_model(asked, field=_FIELD)
            made = load_policy(store.model_folder(ref, field=_FIELD), device=context.device)
            return stored_policy(made, task, stochastic=stochastic, model=ref)
        case "expert":
            return expert_policy(setup.sim, task)
        case _:
            return explorer_policy(setup.sim) if task.has_explorer else uniform_policy(task.action)
    return served_policy(
        context.client("imitation"),
        ModelRef(**pinned) if pinned else made,
        task,
        max_steps_per_goal=max_steps_per_goal,
    )


def _made_by_run(store: PolicyStore, name: str, *, device: str) -> StoredPolicy | ModelRef:
    """Returns the policy, or the model of the imitation service, that a run has made.

    Raises:
        InvalidInput: There is no such run, or it has made neither.
    """
    folder = store.run_folder(name, field=_RUN_FIELD)
    if (folder / "artifacts" / NAMES.card).is_file():
        return load_policy(folder / "artifacts", device=device)
    has_ended = folder.parent == store.siblings or has_succeeded(folder)
    if has_ended and (folder / "model.json").is_file():  # which each fit of a run writes
        return ModelRef(**json.loads((folder / "model.json").read_bytes()))
    raise no_policy(
        field=_RUN_FIELD, hint="Name a ppo run that has succeeded, or one that made a model of the imitation service."
    )
