"""Rollouts of several robots in the sim service, by a policy of the imitation service or at random.

True states are recorded for evaluation; no policy sees them.
"""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.clients import ImitationClient, SimClient
from freerein.errors import ServiceError
from freerein.types.common import Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, ActResponse
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
    StepResponse,
    Truth,
)

Frames = npt.NDArray[np.uint8]
Actions = npt.NDArray[np.float32]
PolicyFn = Callable[[Frames], Awaitable[Actions | None]]
"""Maps frames uint8 (N, H, W, C) of N robots to their next actions float32 (N, A), or to None to end the rollout."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """Trajectories of N robots over T timesteps.

    Attributes:
        frames: uint8 (T, N, H, W, C), what the robots saw.
        states: float64 (T, N, S), the true states.
        lengths: int64 (N,), timesteps of each robot's first episode; later timesteps belong to another episode.
    """

    frames: Frames
    states: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.int64]


@asynccontextmanager
async def robot_session(
    sim: SimClient, task: str, *, camera: str, count: int, seed: int
) -> "AsyncGenerator[RobotSession, None]":
    """Yields a privileged sim session of `count` robots that perform a task; `seed` is that of the episodes."""
    created = await sim.create_session(CreateSessionRequest(task, num_envs=count, seed=seed, privileged=True))
    try:
        await sim.reset(ResetRequest(created.session))
        start = (await sim.snapshot(SnapshotRequest(created.session))).snapshot
        yield RobotSession(sim, created.session, camera, count, created.task.action.size, start)
    finally:
        with suppress(ServiceError):  # the block's own error counts
            await sim.close_session(CloseSessionRequest(created.session))


@dataclass(frozen=True)
class RobotSession:
    """A sim session of `count` robots; each rollout starts from the states in the snapshot `start`."""

    sim: SimClient
    session: str
    camera: str
    count: int
    action_size: int
    start: bytes

    def random_policy(self, rng: np.random.Generator) -> "RandomPolicy":
        """Returns a policy that acts at random."""
        return RandomPolicy(self.action_size, self.count, rng)

    async def rollout(
        self, policy: PolicyFn, *, steps: int, on_step: Callable[[int], None] = lambda _: None
    ) -> Rollout:
        """Returns a rollout from the start states, of at most `steps` steps."""
        step = (await self.sim.restore(RestoreRequest(self.session, self.start))).step_id
        seen = await self._step(step + 1, np.zeros((self.count, self.action_size), np.float32))
        frames, states = [seen.frames[self.camera]], [cast(Truth, seen.truth).state]
        ended = np.full(self.count, steps + 1)
        for t in range(1, steps + 1):
            actions = await policy(frames[-1])
            if actions is None:
                break
            seen = await self._step(step + 1 + t, actions)
            ended = np.where((seen.terminated | seen.truncated) & (ended > steps), t, ended)
            frames.append(seen.frames[self.camera])
            states.append(cast(Truth, seen.truth).state)
            on_step(t)
        return Rollout(np.stack(frames), np.stack(states), np.minimum(ended, len(frames)))

    async def _step(self, step_id: int, actions: Actions) -> StepResponse:
        return await self.sim.step(StepRequest(self.session, step_id, actions, cameras=(self.camera,)))


@dataclass(eq=False)
class ServedPolicy:
    """A policy of the imitation service that pursues one goal per robot until all are done.

    Attributes:
        max_steps_per_goal: Steps after which a goal is abandoned for the next one; 0 for the model's default.
        goal_index: int64 (N,) per timestep, the number of goals that each robot is done with.
        confidence: float64 (N,) per timestep, confidence that the goal pursued is reached.
    """

    client: ImitationClient
    model: ModelRef
    goals: Sequence[Goal]
    camera: str
    max_steps_per_goal: int = 0
    goal_index: list[npt.NDArray[np.int64]] = field(default_factory=list)
    confidence: list[npt.NDArray[np.float64]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._requests = [
            ActRequest(Observation(), goal, max_steps_per_goal=self.max_steps_per_goal, model=self.model)
            for goal in self.goals
        ]

    async def __call__(self, frames: Frames) -> Actions | None:
        """Returns the next actions; robots that are done stay still."""
        answers = await asyncio.gather(*map(self._act, self._requests, frames))
        self.goal_index.append(np.array([answer.goal_index for answer in answers]))
        self.confidence.append(np.array([answer.goal_confidence for answer in answers]))
        actions = [answer.actions[:1] for answer in answers]
        if not any(map(len, actions)):
            return None
        still = np.zeros((1, max(action.shape[1] for action in actions)), np.float32)
        taken = np.concatenate([action if len(action) else still for action in actions])
        self._requests = [
            replace(request, state=answer.state, executed_actions=done[None])
            for request, answer, done in zip(self._requests, answers, taken, strict=True)
        ]
        return taken

    async def _act(self, request: ActRequest, frame: Frames) -> ActResponse:
        image = images.encode(frame, encoding="raw_rgb8", camera=self.camera)
        return await self.client.act(replace(request, observation=Observation((image,))))


@dataclass(eq=False)
class RandomPolicy:
    """Smooth random actions, with the parameters of the sim service's random behaviour."""

    size: int
    count: int
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self._target = self._action = np.zeros((self.count, self.size))
        self._hold_steps = np.zeros((self.count, self.size), np.int64)

    async def __call__(self, _frames: Frames) -> Actions:
        """Returns the next actions."""
        self._hold_steps = self._hold_steps - 1
        is_new = self._hold_steps < 0
        shape = self._target.shape
        extreme = self.rng.random(shape) < _EXTREME_PROBABILITY
        drawn = np.where(extreme, self.rng.choice((-1.0, 1.0), shape), self.rng.uniform(-1, 1, shape))
        self._target = np.where(is_new, drawn, self._target)
        self._hold_steps = np.where(is_new, self.rng.geometric(1 / _MEAN_HOLD_STEPS, shape), self._hold_steps)
        self._action = self._action + _SMOOTHING * (self._target - self._action)
        return self._action.astype(np.float32)


_MEAN_HOLD_STEPS, _SMOOTHING, _EXTREME_PROBABILITY = 6.0, 0.5, 0.3
