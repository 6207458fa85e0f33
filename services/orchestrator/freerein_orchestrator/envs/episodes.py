"""Whole episodes of a policy in a task of the sim service."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import ServiceError
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ResetRequest,
    StepRequest,
    StepResponse,
)
from freerein_orchestrator.envs.policies import PolicyHandle
from freerein_orchestrator.envs.reward_fns import Frames
from freerein_orchestrator.rl.vec_env import Actions

_CLOSE_TIMEOUT_S = 1.0


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of T timesteps.

    Attributes:
        frames: uint8 (T, H, W, C), frame t before action t; (T, 0, 0, 3) without a camera.
        actions: As executed, float32 (T, A) or int64 (T, 1).
        terminated: bool (T,), whether the episode terminated after action t; not where a time limit ended it.
        rewards: The oracle's, float32 (T,); empty unless the session was privileged.
        success: Whether the goal holds at the end; False unless the session was privileged.
    """

    frames: Frames
    actions: Actions
    terminated: npt.NDArray[np.bool_]
    rewards: npt.NDArray[np.float32]
    success: bool


def derive_seed(*numbers: int) -> int:
    """Returns a seed derived from numbers, such as a run's seed and the number of episodes before."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def run_episodes(
    sim: SyncClient, request: CreateSessionRequest, policy: PolicyHandle, interrupt: Callable[[], None]
) -> tuple[Episode, ...]:
    """Returns one episode per environment of a new session; the same for the same seed and policy.

    Args:
        sim: The sim service's client.
        request: The session, with a seed, and frames of the policy's size.
        policy: Acts; its random draws are seeded by the session's seed.
        interrupt: Called before each step; raises to stop.

    Raises:
        ServiceError: The service or the policy failed; the episodes can be run again.
    """
    session: str = sim.create_session(request).session
    cameras = (policy.camera,) if policy.camera else ()
    steps: list[tuple[Frames, Actions, StepResponse]] = []
    lengths = np.zeros(request.num_envs, np.int64)
    try:
        started = policy.start(request.seed or 0)
        frames = _camera_frames(
            sim.reset(ResetRequest(session, cameras=cameras)).frames, policy.camera, request.num_envs
        )
        starts = np.ones(request.num_envs, np.bool_)
        while not lengths.all():
            interrupt()
            actions = started.act(frames, starts)
            reply: StepResponse = sim.step(StepRequest(session, len(steps) + 1, actions, cameras=cameras))
            steps.append((frames, actions, reply))
            starts = reply.terminated | reply.truncated
            lengths[starts & (lengths == 0)] = len(steps)
            frames = _camera_frames(reply.frames, policy.camera, request.num_envs)
    finally:
        with suppress(ServiceError):  # its lease will end it
            sim.close_session(CloseSessionRequest(session), timeout_s=_CLOSE_TIMEOUT_S)
    return tuple(_episode(steps[:length], env) for env, length in enumerate(lengths))


def _episode(steps: list[tuple[Frames, Actions, StepResponse]], env: int) -> Episode:
    truths = [reply.truth for _, _, reply in steps if reply.truth is not None]
    return Episode(
        frames=np.stack([frames[env] for frames, _, _ in steps]),
        actions=np.stack([actions[env] for _, actions, _ in steps]),
        terminated=np.array([reply.terminated[env] for _, _, reply in steps], np.bool_),
        rewards=np.array([truth.reward[env] for truth in truths], np.float32),
        success=bool(truths and truths[-1].success[env]),
    )


def _camera_frames(frames: dict[str, Frames], camera: str, num_envs: int) -> Frames:
    return frames[camera] if camera else np.zeros((num_envs, 0, 0, 3), np.uint8)
