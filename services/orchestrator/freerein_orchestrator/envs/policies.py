"""Policies that can act in a task: stored, served, untrained or random."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt
import torch

from freerein import images
from freerein.clients import SyncClient
from freerein.types.common import ActionSpec, Encoding, Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse
from freerein.types.sim import Task
from freerein_orchestrator.envs.policy_interface import PolicyInterface, check_task
from freerein_orchestrator.envs.reward_fns import Frames
from freerein_orchestrator.rl.policy_files import NetworkPolicy, StoredPolicy
from freerein_orchestrator.rl.vec_env import Actions, Observations

_MAX_THREADS = 64
"""Calls at once: the most environments that a session may have."""


class BatchPolicy(Protocol):
    """Acts in N environments, timestep by timestep."""

    def act(self, frames: Observations, episode_starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action per environment, given frames uint8 (N, H, W, C) and bool (N,)."""


@dataclass(frozen=True, eq=False)
class PolicyHandle:
    """A policy that can be started any number of times.

    Attributes:
        start: Returns, for a seed, a policy without recurrent state.
        description: The policy, for results; JSON.
        camera: The camera that it sees; empty for none.
        height: Frame height in pixels.
        width: Frame width in pixels.
    """

    start: Callable[[int], BatchPolicy]
    description: dict[str, Any]
    camera: str = ""
    height: int = 0
    width: int = 0


def random_policy(action: ActionSpec) -> PolicyHandle:
    """Returns the policy of uniform actions: in [-1, 1], or among all choices."""
    return PolicyHandle(lambda seed: _RandomPolicy(action, np.random.default_rng(seed)), {"policy": "random"})


def stored_policy(policy: StoredPolicy, task: Task, *, stochastic: bool, model: ModelRef | None = None) -> PolicyHandle:
    """Returns a policy of a ppo run; `stochastic` samples its actions, else the most likely one is taken.

    `model` is its reference among the stored models, if it is one of them.

    Raises:
        InvalidInput: The task has another camera or other actions.
    """
    spec = PolicyInterface.of_stored(policy)
    check_task(spec, task)

    def start(seed: int) -> BatchPolicy:
        return NetworkPolicy(policy.network, generator=torch.Generator().manual_seed(seed) if stochastic else None)

    description: dict[str, Any] = {"policy": "ppo", "sha256": policy.card["sha256"], "stochastic": stochastic}
    if model is not None:
        description["model"] = asdict(model)
    return PolicyHandle(start, description, spec.camera, spec.height, spec.width)


def served_policy(
    imitation: SyncClient, model: ModelRef, goal: Goal, task: Task, *, closing: ExitStack
) -> PolicyHandle:
    """Returns a model of the imitation service, pinned to one version.

    Args:
        imitation: The service's client.
        model: The model; without a version, the active one.
        goal: Its goal.
        task: Where it acts.
        closing: Ends the threads that call the service.

    Raises:
        InvalidInput: The task has another camera or other actions.
        ServiceError: The service has no such model, or cannot be reached.
    """
    reply: GetSpecResponse = imitation.get_spec(GetSpecRequest(model))
    spec = PolicyInterface.of_served(reply)
    check_task(spec, task)
    pool = closing.enter_context(ThreadPoolExecutor(_MAX_THREADS, thread_name_prefix="act"))
    request = ActRequest(Observation(), goal, model=reply.model)
    return PolicyHandle(
        lambda _seed: _ServedPolicy(imitation, request, reply.action, spec.camera, pool),
        {"policy": "imitation", "model": asdict(reply.model), "goal_text": goal.text, "recipe": list(goal.recipe)},
        spec.camera,
        spec.height,
        spec.width,
    )


class _RandomPolicy:
    """Uniform actions."""

    def __init__(self, action: ActionSpec, rng: np.random.Generator) -> None:
        self._action = action
        self._rng = rng

    def act(self, frames: Observations, episode_starts: npt.NDArray[np.bool_]) -> Actions:
        shape = len(episode_starts), self._action.size
        if self._action.choices:
            return self._rng.integers(self._action.choices, size=shape)
        return self._rng.uniform(-1, 1, shape).astype(np.float32)


class _ServedPolicy:
    """Calls the imitation service once per environment, concurrently, so that it batches the calls."""

    def __init__(
        self, imitation: SyncClient, request: ActRequest, action: ActionSpec, camera: str, pool: ThreadPoolExecutor
    ) -> None:
        self._imitation = imitation
        self._first_request = request
        self._hold = np.zeros((1, action.size), np.int64 if action.choices else np.float32)
        self._camera = camera
        self._pool = pool
        self._requests: list[ActRequest] = []

    def act(self, frames: Observations, episode_starts: npt.NDArray[np.bool_]) -> Actions:
        """Returns an action per environment; zeros where the policy has ended."""
        last = self._requests or [self._first_request] * len(episode_starts)
        requests = [self._first_request if start else old for start, old in zip(episode_starts, last, strict=True)]
        replies = list(self._pool.map(self._call, requests, cast(Frames, frames)))
        actions = [reply.actions[:1] if len(reply.actions) else self._hold for reply in replies]
        self._requests = [
            replace(request, state=reply.state, executed_actions=executed)
            for request, reply, executed in zip(requests, replies, actions, strict=True)
        ]
        return cast(Actions, np.concatenate(actions))

    def _call(self, request: ActRequest, frame: Frames) -> ActResponse:
        encoding: Encoding = "raw_rgb8" if frame.shape[2] == 3 else "raw_gray8"
        image = images.encode(frame, encoding=encoding, camera=self._camera)
        return cast(ActResponse, self._imitation.act(replace(request, observation=Observation((image,)))))
