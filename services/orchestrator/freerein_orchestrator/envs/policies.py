"""Policies that can act in a task: stored, served, or the scripted expert."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt
import torch

from freerein import images
from freerein.clients import SyncClient
from freerein.errors import InvalidInput
from freerein.learning.actor_critic.policy_files import StoredPolicy
from freerein.types.common import Encoding, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActBatchRequest, ActRequest, ActResponse, GetSpecRequest
from freerein.types.sim import ExpertActionsRequest, Recipe, Task
from freerein_orchestrator.envs.policy_interface import PolicyInterface, check_task
from freerein_orchestrator.rl.network_policy import NetworkPolicy
from freerein_orchestrator.rl.vec_env import Actions, Frames, join_cameras

_MOST_BYTES = 32 * 2**20
"""Of the images of a call, half of a message; environments whose images are more take several."""


@dataclass(frozen=True)
class PolicySession:
    """The session that a policy acts in.

    Attributes:
        id: The session of the sim service.
        seed: Seed of the policy's random draws.
        goals: The goal of each environment; empty for a policy that takes none.
    """

    id: str
    seed: int
    goals: Sequence[Goal] = ()


@dataclass(frozen=True, eq=False)
class PolicyOutput:
    """A policy's answer to the frames of N environments.

    Attributes:
        actions: float32 (N, A) or int64 (N, 1).
        goal_index: int64 (N,), number of goals that are over, reached or abandoned; None for a policy without goals.
        goal_confidence: float64 (N,), confidence that the frame reaches the current goal; None likewise.
    """

    actions: Actions
    goal_index: npt.NDArray[np.int64] | None = None
    goal_confidence: npt.NDArray[np.float64] | None = None


class BatchPolicy(Protocol):
    """Acts in N environments, timestep by timestep."""

    def act(self, frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        """Returns an action per environment, given frames by camera, uint8 (N, H, W, C), and bool (N,)."""


@dataclass(frozen=True, eq=False)
class PolicyHandle:
    """A policy that can be started any number of times.

    Attributes:
        start: Returns, for a session, a policy without recurrent state.
        description: The policy, for results; JSON.
        cameras: The cameras that it sees; empty for none.
        height: Frame height in pixels; 0 for the cameras' own.
        width: Frame width in pixels; as `height`.
        max_steps_per_goal: Steps after which it abandons a goal; 0 for a policy without goals.
        skills: Skills that its recipes may name; empty for any.
    """

    start: Callable[[PolicySession], BatchPolicy]
    description: dict[str, Any]
    cameras: tuple[str, ...] = ()
    height: int = 0
    width: int = 0
    max_steps_per_goal: int = 0
    skills: tuple[str, ...] = ()


def stored_policy(policy: StoredPolicy, task: Task, *, stochastic: bool, model: ModelRef | None = None) -> PolicyHandle:
    """Returns a policy of a ppo run; `stochastic` samples its actions, else the most likely one is taken.

    `model` is its reference among the stored models, if it is one of them.

    Raises:
        InvalidInput: The task has another camera or other actions.
    """
    spec = PolicyInterface.of_stored(policy)
    check_task(spec, task)

    def start(session: PolicySession) -> BatchPolicy:
        generator = torch.Generator().manual_seed(session.seed) if stochastic else None
        return _StoredPolicy(NetworkPolicy(policy.network, generator=generator), policy.cameras)

    description: dict[str, Any] = {"policy": "ppo", "sha256": policy.card["sha256"], "stochastic": stochastic}
    if model is not None:
        description["model"] = asdict(model)
    return PolicyHandle(start, description, policy.cameras, spec.cameras[0].height, spec.cameras[0].width)


def served_policy(imitation: SyncClient, model: ModelRef, task: Task, *, max_steps_per_goal: int = 0) -> PolicyHandle:
    """Returns a model of the imitation service, pinned to one version, which is given a goal per environment.

    Args:
        imitation: The service's client.
        model: The model; without a version, the active one.
        task: Where it acts.
        max_steps_per_goal: Steps after which a goal is abandoned; 0 for the model's own limit.

    Raises:
        InvalidInput: The task has other cameras or other actions.
        ServiceError: The service has no such model, or cannot be reached.
    """
    reply = imitation.get_spec(GetSpecRequest(model))
    spec = PolicyInterface.of_served(reply)
    check_task(spec, task)
    hold = task.action.nearest_to_hold()[None]

    def start(session: PolicySession) -> BatchPolicy:
        requests = [
            ActRequest(Observation(), goal, max_steps_per_goal=max_steps_per_goal, model=reply.model)
            for goal in session.goals
        ]
        return ServedPolicy(imitation, requests, hold)

    return PolicyHandle(
        start,
        {"policy": "imitation", "model": asdict(reply.model)},
        tuple(camera.name for camera in spec.cameras),
        *spec.frame_size(task),
        max_steps_per_goal or reply.max_steps_per_goal,
        reply.skills,
    )


def expert_policy(sim: SyncClient, task: Task) -> PolicyHandle:
    """Returns the task's scripted expert, which acts in privileged sessions; its goals are recipes.

    Raises:
        InvalidInput: The task has no expert.
    """
    if not task.has_expert:
        raise InvalidInput(
            f"The expert needs a task that has one; {task.name} has none.",
            field="config.policy",
            hint="Evaluate another policy, or choose another task.",
        )
    return PolicyHandle(lambda session: _ExpertPolicy(sim, task, session), {"policy": "expert"})


def explorer_policy(sim: SyncClient) -> PolicyHandle:
    """Returns the explorer of a task that has one of its own, which acts in privileged sessions."""
    return PolicyHandle(lambda session: _Explorer(sim, session.id), {"policy": "random", "explorer": True})


@dataclass(frozen=True)
class _Explorer:
    """Asks the sim service, which knows what the explorer may."""

    sim: SyncClient
    session: str

    def act(self, _frames: Mapping[str, Frames], _episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        return PolicyOutput(self.sim.expert_actions(ExpertActionsRequest(self.session, behaviour="random")).actions)


@dataclass(frozen=True)
class _StoredPolicy:
    """Acts with a network."""

    network: NetworkPolicy
    cameras: tuple[str, ...]

    def act(self, frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        return PolicyOutput(self.network.act(join_cameras(frames, self.cameras), episode_starts))


class _ExpertPolicy:
    """Asks the sim service, which knows the session's true states.

    Goals are of first episodes. In a later one, which nobody records, the expert does what the episode itself requires:
    its scene may lack an object that the goal names.
    """

    def __init__(self, sim: SyncClient, task: Task, session: PolicySession) -> None:
        self._sim = sim
        self._session = session
        self._recipes = [[task.skills.index(skill) for skill in goal.recipe] for goal in session.goals]
        self._over = np.zeros(len(session.goals), np.int64)
        self._asked: tuple[Recipe, ...] | None = None

    def act(self, _frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        self._asked = self._recipes_to_ask(episode_starts)
        reply = self._sim.expert_actions(ExpertActionsRequest(self._session.id, self._asked))
        if not self._asked:
            return PolicyOutput(reply.actions)
        places = zip(self._recipes, reply.skills.tolist(), reply.finished.tolist(), strict=True)
        over = [
            len(recipe) if finished else recipe.index(skill) if skill in recipe else 0
            for recipe, skill, finished in places
        ]
        self._over = np.maximum(np.where(episode_starts, 0, self._over), over)
        return PolicyOutput(reply.actions, self._over)

    def _recipes_to_ask(self, episode_starts: npt.NDArray[np.bool_]) -> tuple[Recipe, ...]:
        """Returns the goal's recipe of each environment, empty once its first episode is over."""
        if self._asked is None:
            return tuple(Recipe(goal.recipe) for goal in self._session.goals)
        envs = zip(self._asked, episode_starts.tolist(), strict=True)
        return tuple(Recipe() if starts else recipe for recipe, starts in envs) if self._asked else ()


class ServedPolicy:
    """Calls the imitation service for all environments at once: equal frames have equal actions, to the bit.

    An environment whose goals are all over holds: its last answer stays. So it does after its first episode, for nobody
    records another one.

    Attributes:
        hold: The action that holds, (1, A).
    """

    def __init__(self, imitation: SyncClient, requests: Sequence[ActRequest], hold: Actions) -> None:
        self._imitation = imitation
        self._first_requests = list(requests)
        self.hold = hold
        self._requests = list(requests)
        self._replies: list[ActResponse | None] = [None] * len(requests)
        self._episodes = np.zeros(len(requests), np.int64)

    def act(self, frames: Mapping[str, Frames], episode_starts: npt.NDArray[np.bool_]) -> PolicyOutput:
        """Returns an action per environment, and how far each is, as `BatchPolicy.act`."""
        self._episodes += episode_starts
        acts = (self._episodes == 1).tolist()
        replies = self._ask(frames, acts)
        answers = zip(replies, acts, strict=True)
        actions = [reply.actions[:1] if is_acting and len(reply.actions) else self.hold for reply, is_acting in answers]
        self._replies = list(replies)
        self._requests = [
            replace(request, state=reply.state, executed_actions=executed)
            for request, reply, executed in zip(self._requests, replies, actions, strict=True)
        ]
        return PolicyOutput(
            cast(Actions, np.concatenate(actions)),
            np.array([reply.goal_index for reply in replies], np.int64),
            np.array([reply.goal_confidence for reply in replies], np.float64),
        )

    def begin(self, env: int, goal: Goal) -> None:
        """Gives an environment another goal; of what was before it knows the last action alone."""
        self._first_requests[env] = replace(self._first_requests[env], goal=goal)
        executed = self._requests[env].executed_actions
        self._requests[env], self._replies[env] = replace(self._first_requests[env], executed_actions=executed), None

    def _ask(self, frames: Mapping[str, Frames], acts: Sequence[bool]) -> list[ActResponse]:
        """Returns the answer of each environment, where it does not act any more the last one."""
        last, all_envs = dict(enumerate(self._replies)), enumerate(zip(self._replies, acts, strict=True))
        asking = [env for env, (said, is_acting) in all_envs if said is None or (is_acting and len(said.actions))]
        requests = []
        for env in asking:
            images_of = tuple(encode_raw(frame[env], camera) for camera, frame in frames.items())
            requests.append(replace(self._requests[env], observation=Observation(images_of)))
        last |= zip(asking, chain.from_iterable(map(self._call, _in_calls(requests))), strict=True)
        return cast(list[ActResponse], list(last.values()))

    def _call(self, requests: Sequence[ActRequest]) -> tuple[ActResponse, ...]:
        return self._imitation.act_batch(ActBatchRequest(tuple(requests))).responses


def _in_calls(requests: Sequence[ActRequest]) -> Iterator[Sequence[ActRequest]]:
    """Yields requests, as many at a time as a message holds."""
    size = max((sum(len(each.data) for each in _images_of(request)) for request in requests), default=1)
    at_once = max(1, _MOST_BYTES // max(1, size))
    for first in range(0, len(requests), at_once):
        yield requests[first : first + at_once]


def _images_of(request: ActRequest) -> tuple[Image, ...]:
    return (*request.observation.images, *request.goal.images)


def encode_raw(frame: Frames, camera: str) -> Image:
    """Returns a frame, uint8 (H, W, C), of a camera as an image without compression."""
    encoding: Encoding = "raw_rgb8" if frame.shape[2] == 3 else "raw_gray8"
    return images.encode(frame, encoding=encoding, camera=camera)
