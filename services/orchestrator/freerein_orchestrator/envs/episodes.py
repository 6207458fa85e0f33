"""Whole episodes of a policy in a task of the sim service."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import ServiceError
from freerein.types.common import Goal
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    Recipe,
    ResetRequest,
    StepRequest,
    StepResponse,
    Truth,
)
from freerein_orchestrator.envs.policies import PolicyHandle, PolicyOutput, PolicySession
from freerein_orchestrator.rl.vec_env import Actions, Frames

_CLOSE_TIMEOUT_S = 1.0

D = TypeVar("D", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T timesteps, or its first T.

    Attributes:
        frames: By recorded camera: uint8 (T + 1, H, W, C), frame t before action t, and that after the last action.
        actions: As executed, float32 (T, A) or int64 (T, 1).
        terminated: bool (T,), whether the episode terminated after action t; not where a time limit ended it.
        states: float64 (T + 1, S), true states at the frames, as of `finite_truth`; S = 0 unless the session was
            privileged.
        rewards: The oracle's, float32 (T,); empty unless the session was privileged.
        success: Whether the goal holds at the end; False unless the session was privileged.
        goal_index: int64 (T,), number of goals that were over according to the policy's answer to frame t; None for a
            policy that does not follow goals.
        goal_confidence: float64 (T,), its confidence that frame t reaches the current goal; None likewise.
    """

    frames: dict[str, Frames]
    actions: Actions
    terminated: npt.NDArray[np.bool_]
    states: npt.NDArray[np.float64]
    rewards: npt.NDArray[np.float32]
    success: bool
    goal_index: npt.NDArray[np.int64] | None
    goal_confidence: npt.NDArray[np.float64] | None


def derive_seed(*numbers: int) -> int:
    """Returns a seed derived from numbers, such as a run's seed and the number of episodes before.

    Zeros at the end of up to four numbers do not count, as numpy fills its pool of entropy with them: (5,) and (5, 0)
    give one seed. So a caller's keys have one length, or those that are longer do not end in 0.
    """
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def run_episodes(
    sim: SyncClient,
    request: CreateSessionRequest,
    policy: PolicyHandle,
    interrupt: Callable[[], None],
    *,
    goals: Sequence[Goal] = (),
    recipes: Sequence[Recipe] = (),
    cameras: Sequence[str] = (),
    max_steps: int = 0,
    tell: Callable[[npt.NDArray[np.float64]], None] = lambda _states: None,
    last_goals: Sequence[int] = (),
) -> tuple[Episode, ...]:
    """Returns one episode per environment of a new session; the same for the same seed and policy.

    Args:
        sim: The sim service's client.
        request: The session, with a seed, and frames of the policy's size.
        policy: Acts; its random draws are seeded by the session's seed.
        interrupt: Called before each step; raises to stop.
        goals: The goal of each environment; empty for a policy that takes none.
        recipes: What each episode requires; empty for what the worlds draw.
        cameras: Cameras to record, whether the policy sees them or not. None by default: each frame is kept in memory.
        max_steps: Steps after which episodes are cut off; 0 for whole episodes.
        tell: Called before each action with the environments' true states, float64 (N, S), of a privileged session.
        last_goals: By environment, how many goals the policy has there: the run ends after the first step at which
            these, or the episode, are over in all environments. Empty to go on.

    Raises:
        ServiceError: The service or the policy failed; the episodes can be run again.
    """
    rendered = tuple(dict.fromkeys((*policy.cameras, *cameras)))
    steps: list[_Step] = []
    lengths = np.zeros(request.num_envs, np.int64)
    with open_session(sim, request) as session:
        acting = policy.start(PolicySession(session, request.seed or 0, goals))
        first = sim.reset(ResetRequest(session, cameras=rendered, recipes=tuple(recipes)))
        frames, starts, truth = first.frames, np.ones(request.num_envs, np.bool_), first.truth
        while not lengths.all() and (not max_steps or len(steps) < max_steps):
            interrupt()
            if truth is not None:
                tell(truth.state)
            output = acting.act(frames, starts)
            reply = sim.step(StepRequest(session, len(steps) + 1, output.actions, cameras=rendered))
            reply = replace(reply, truth=finite_truth(reply.truth, truth))
            steps.append(_Step(frames, output, reply).recorded(cameras))
            frames, starts, truth = reply.frames, reply.terminated | reply.truncated, reply.truth
            lengths[starts & (lengths == 0)] = len(steps)
            if (
                last_goals
                and output.goal_index is not None
                and ((output.goal_index >= last_goals) | (lengths > 0)).all()
            ):
                break
    lengths[lengths == 0] = len(steps)
    return tuple(_episode(first.truth, steps[:length], env) for env, length in enumerate(lengths))


def replay(
    sim: SyncClient,
    request: CreateSessionRequest,
    actions: Actions,
    interrupt: Callable[[], None],
    *,
    camera: str,
    times: Collection[int],
    recipes: Sequence[Recipe] = (),
) -> Frames:
    """Returns frames of an episode that was run before, uint8 (K, H, W, C), in order of time.

    Args:
        sim: The sim service's client.
        request: A session equal to that of the episode, but of another frame size, whose last environment had it.
        actions: The episode's, as executed: float32 (T, A) or int64 (T, 1).
        interrupt: Called before each step; raises to stop.
        camera: What is rendered.
        times: K different timesteps, 0 to T: frame t is before action t.
        recipes: What the environments' episodes require; empty for what the worlds draw.

    Raises:
        InvalidInput: The world renders no frames of this size.
        ServiceError: The service failed; the episode can be replayed again.
    """
    frames = []
    with open_session(sim, request) as session:
        first = sim.reset(ResetRequest(session, cameras=(camera,), recipes=tuple(recipes)))
        if 0 in times:
            frames.append(first.frames[camera][-1])
        for t, action in enumerate(actions[: max(times, default=0)], 1):
            interrupt()
            cameras = (camera,) if t in times else ()
            step = StepRequest(session, t, np.tile(action, (request.num_envs, 1)), cameras=cameras)
            reply = sim.step(step)
            if cameras:
                frames.append(_final_frames(reply, request.num_envs - 1)[camera])
    return np.array(frames, np.uint8)


def finite_truth(truth: Truth | None, before: Truth | None) -> Truth | None:
    """Returns what is true after a step; where the simulation diverged, the state is that before it.

    The sim service judges finite states alone: a single episode that diverged would end a whole evaluation.

    Args:
        truth: After the step; None in an unprivileged session.
        before: Before it, likewise.
    """
    if truth is None or before is None:
        return truth
    is_finite = np.isfinite(truth.state).all(axis=1, keepdims=True)
    return replace(truth, state=np.where(is_finite, truth.state, before.state))


@contextmanager
def open_session(sim: SyncClient, request: CreateSessionRequest) -> Iterator[str]:
    """Yields the id of a new session."""
    session: str = sim.create_session(request).session
    try:
        yield session
    finally:
        with suppress(ServiceError):  # its lease will end it
            sim.close_session(CloseSessionRequest(session), timeout_s=_CLOSE_TIMEOUT_S)


@dataclass(frozen=True, eq=False)
class _Step:
    """Frames before a step of all environments, the policy's output for them, and the reply of the sim service."""

    frames: dict[str, Frames]
    output: PolicyOutput
    reply: StepResponse

    def recorded(self, cameras: Sequence[str]) -> "_Step":
        """Returns the step with the frames of these cameras alone."""

        def chosen(frames: Mapping[str, Frames]) -> dict[str, Frames]:
            return {camera: each for camera, each in frames.items() if camera in cameras}

        reply = replace(self.reply, frames=chosen(self.reply.frames), final_frames=chosen(self.reply.final_frames))
        return _Step(chosen(self.frames), self.output, reply)


def _episode(first: Truth | None, steps: Sequence[_Step], env: int) -> Episode:
    truths = [step.reply.truth for step in steps if step.reply.truth is not None]
    states = [truth.state[env] for truth in (first, *truths) if truth is not None]
    outputs = [step.output for step in steps]
    last = _final_frames(steps[-1].reply, env)
    return Episode(
        frames={camera: np.stack([*(step.frames[camera][env] for step in steps), last[camera]]) for camera in last},
        actions=np.stack([output.actions[env] for output in outputs]),
        terminated=np.array([step.reply.terminated[env] for step in steps], np.bool_),
        states=np.stack(states) if states else np.zeros((len(steps) + 1, 0)),
        rewards=np.array([truth.reward[env] for truth in truths], np.float32),
        success=bool(truths and truths[-1].success[env]),
        goal_index=_column([output.goal_index for output in outputs], env),
        goal_confidence=_column([output.goal_confidence for output in outputs], env),
    )


def _final_frames(reply: StepResponse, env: int) -> dict[str, Frames]:
    """Returns the frame after a step, by camera: of the old episode where one ended."""
    done = reply.terminated | reply.truncated
    if done[env]:
        return {camera: frames[int(done[:env].sum())] for camera, frames in reply.final_frames.items()}
    return {camera: frames[env] for camera, frames in reply.frames.items()}


def _column(values: Sequence[npt.NDArray[D] | None], env: int) -> npt.NDArray[D] | None:
    known = [value[env] for value in values if value is not None]
    return np.array(known) if known else None
