"""Who can act in a task: a policy of a run, a model of the imitation service, or chance."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt
import torch

from freerein import images
from freerein.clients import SyncClient
from freerein.errors import InvalidInput
from freerein.learning.config import parse
from freerein.types.common import ActionSpec, Encoding, Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse
from freerein.types.sim import Task
from freerein_orchestrator.bearings import Bearing, check_bearing
from freerein_orchestrator.policy_artifact import Actor, Policy, PolicyActor
from freerein_orchestrator.rollout import Actions, Observations

Frames = npt.NDArray[np.uint8]

_THREADS = 64
"""Environments whose actions are asked for at once; a session has no more."""


@dataclass(frozen=True)
class FromRun:
    """Names the policy that a run has made.

    Attributes:
        run: A ppo run's id, or a pipeline's earlier step; or a run that has made a model of the imitation service.
        goal_text: Of such a model, what to do.
        is_stochastic: Whether actions of a ppo run's policy are drawn from it; else the likeliest is taken.
    """

    run: str
    goal_text: str = ""
    is_stochastic: bool = False


@dataclass(frozen=True)
class FromModel:
    """Names a model of the imitation service, and says what it is to do.

    Attributes:
        model: Its name.
        version: Its version; empty for the active one.
        goal_text: What to do, in words.
        recipe: Or the skills to execute, one after the other.
    """

    model: str
    version: str = ""
    goal_text: str = ""
    recipe: tuple[str, ...] = ()


Choice = Literal["random"] | FromRun | FromModel


def choose(asked: str | Mapping[str, Any]) -> Choice:
    """Returns the choice that a configuration makes.

    Raises:
        InvalidInput: It makes none, or two.
    """
    if not isinstance(asked, Mapping):
        return "random"
    if ("run" in asked) == ("model" in asked):
        raise InvalidInput(
            '`policy` must be "random", or name either a `run` or a `model`; it names both or neither.',
            field="config.policy",
            hint='{"run": "<id>"} is a policy of PPO, {"model": "default", "goal_text": "..."} one of imitation.',
        )
    return parse(FromRun, asked) if "run" in asked else parse(FromModel, asked)


@dataclass(frozen=True, eq=False)
class Pilot:
    """Who acts, and what it has to see.

    Attributes:
        begin: Returns, for a seed, an actor that remembers nothing.
        told: Who this is, for a result; JSON.
        camera: What it sees through; empty when it sees nothing.
        height: Of the frames, in pixels.
        width: Of the frames, in pixels.
    """

    begin: Callable[[int], Actor]
    told: dict[str, Any]
    camera: str = ""
    height: int = 0
    width: int = 0


def by_chance(action: ActionSpec) -> Pilot:
    """Returns who draws every action anew: uniform in [-1, 1], or among all choices."""
    return Pilot(lambda seed: _Chance(action, np.random.default_rng(seed)), {"policy": "random"})


def of_policy(policy: Policy, task: Task, *, is_stochastic: bool) -> Pilot:
    """Returns who acts by a policy of a ppo run.

    Raises:
        InvalidInput: The policy is none for such a task.
    """
    bearing = Bearing.of(policy)
    check_bearing(bearing, task)

    def begin(seed: int) -> Actor:
        return PolicyActor(policy.network, generator=torch.Generator().manual_seed(seed) if is_stochastic else None)

    told = {"policy": "ppo", "sha256": policy.card["sha256"], "is_stochastic": is_stochastic}
    return Pilot(begin, told, bearing.camera, bearing.height, bearing.width)


def of_model(imitation: SyncClient, model: ModelRef, goal: Goal, task: Task, *, closing: ExitStack) -> Pilot:
    """Returns who acts by a model of the imitation service, always the same version of it.

    Args:
        imitation: The service.
        model: Which; without a version, the one that is active now.
        goal: What is to be done.
        task: Where.
        closing: Ends the threads that ask for actions of several environments at once.

    Raises:
        InvalidInput: The model is none for such a task.
        ServiceError: The service has no such model, or cannot be reached.
    """
    spec: GetSpecResponse = imitation.get_spec(GetSpecRequest(model))
    camera = spec.cameras[0]
    bearing = Bearing(camera.name, camera.height, camera.width, camera.channels, spec.action.size, spec.action.choices)
    check_bearing(bearing, task)
    pool = closing.enter_context(ThreadPoolExecutor(_THREADS, thread_name_prefix="act"))
    told = {"policy": "imitation", "model": asdict(spec.model), "goal_text": goal.text, "recipe": list(goal.recipe)}
    blank = ActRequest(Observation(), goal, model=spec.model)
    return Pilot(
        lambda _seed: _Served(imitation, blank, spec.action, camera.name, pool),
        told,
        camera.name,
        camera.height,
        camera.width,
    )


class _Chance:
    """Acts at random."""

    def __init__(self, action: ActionSpec, rng: np.random.Generator) -> None:
        self._action = action
        self._rng = rng

    def act(self, frames: Observations, starts: npt.NDArray[np.bool_]) -> Actions:
        shape = len(starts), self._action.size
        if self._action.choices:
            return self._rng.integers(self._action.choices, size=shape)
        return self._rng.uniform(-1, 1, shape).astype(np.float32)


class _Served:
    """Acts by the imitation service: one call for each environment, all at once, so that it takes them as a batch."""

    def __init__(
        self, imitation: SyncClient, blank: ActRequest, action: ActionSpec, camera: str, pool: ThreadPoolExecutor
    ) -> None:
        self._imitation = imitation
        self._blank = blank
        self._still = np.zeros((1, action.size), np.int64 if action.choices else np.float32)
        self._camera = camera
        self._pool = pool
        self._requests: list[ActRequest] = []

    def act(self, frames: Observations, starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action for each environment; where nothing is left to do, it holds: 0, the first choice."""
        before = self._requests or [self._blank] * len(starts)
        asked = [self._blank if start else request for start, request in zip(starts, before, strict=True)]
        answers = list(self._pool.map(self._ask, asked, cast(Frames, frames)))
        actions = [answer.actions[:1] if len(answer.actions) else self._still for answer in answers]
        self._requests = [
            replace(request, state=answer.state, executed_actions=executed)
            for request, answer, executed in zip(asked, answers, actions, strict=True)
        ]
        return cast(Actions, np.concatenate(actions))

    def _ask(self, request: ActRequest, frame: Frames) -> ActResponse:
        encoding: Encoding = "raw_rgb8" if frame.shape[2] == 3 else "raw_gray8"
        image = images.encode(frame, encoding=encoding, camera=self._camera)
        return cast(ActResponse, self._imitation.act(replace(request, observation=Observation((image,)))))
