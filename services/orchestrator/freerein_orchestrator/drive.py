"""Episodes of a task of the sim service, driven by whoever acts: what was seen, what was done, what came of it."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import InvalidInput, ServiceError
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ListTasksRequest,
    ResetRequest,
    StepRequest,
    StepResponse,
    Task,
)
from freerein_orchestrator.actors import Pilot
from freerein_orchestrator.rollout import Actions

Frames = npt.NDArray[np.uint8]

_CLOSE_S = 1.0


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode from its beginning to its end, T timesteps.

    Attributes:
        frames: uint8 (T, H, W, C); frame t was seen before action t. Without a camera (T, 0, 0, 3).
        actions: As they were executed, float32 (T, A) or int64 (T, 1).
        rewards: The oracle's, float32 (T,); empty unless the session was privileged.
        is_success: Whether the goal holds in the end; False unless the session was privileged.
    """

    frames: Frames
    actions: Actions
    rewards: npt.NDArray[np.float32]
    is_success: bool


def find_task(sim: SyncClient, name: str) -> Task:
    """Returns the task of a name.

    Raises:
        InvalidInput: The sim service has none.
    """
    for task in cast(tuple[Task, ...], sim.list_tasks(ListTasksRequest()).tasks):
        if task.name == name:
            return task
    raise InvalidInput(
        "`task` must be one of the sim service's; it has none of that name.",
        field="config.task",
        hint="`freerein sim tasks` names them.",
    )


def seed_of(*numbers: int) -> int:
    """Returns a seed that follows from numbers, such as a run's seed and how many episodes came before."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


def play(
    sim: SyncClient, request: CreateSessionRequest, pilot: Pilot, interrupt: Callable[[], None]
) -> tuple[Episode, ...]:
    """Returns one episode of each environment of a new session: the same for the same seed and pilot.

    Environments whose episode has ended go on stepping, unseen, until all have ended.

    Args:
        sim: The service.
        request: The session, with a seed, and frames of the size that the pilot sees.
        pilot: Acts; what it draws follows from the session's seed.
        interrupt: Called before each step; raises to end it all.

    Raises:
        ServiceError: What the service or the actor raises; `served_rollouts.persist` plays again where that helps.
    """
    session: str = sim.create_session(request).session
    cameras, actor = (pilot.camera,) if pilot.camera else (), pilot.begin(request.seed or 0)
    try:
        records = _Records(request.num_envs)
        seen = _view(sim.reset(ResetRequest(session, cameras=cameras)).frames, pilot.camera, request.num_envs)
        starts = np.ones(request.num_envs, np.bool_)
        for step_id in range(1, 1 << 31):
            interrupt()
            actions = actor.act(seen, starts)
            reply: StepResponse = sim.step(StepRequest(session, step_id, actions, cameras=cameras))
            if records.add(seen, actions, reply):
                break
            seen, starts = _view(reply.frames, pilot.camera, request.num_envs), reply.terminated | reply.truncated
        return records.episodes()
    finally:
        with suppress(ServiceError):  # it ends with its lease
            sim.close_session(CloseSessionRequest(session), timeout_s=_CLOSE_S)


class _Records:
    """What happens in each of N environments until its first episode ends."""

    def __init__(self, num_envs: int) -> None:
        self._steps: list[tuple[Frames, Actions, StepResponse]] = []
        self._lengths = np.zeros(num_envs, np.int64)

    def add(self, seen: Frames, actions: Actions, reply: StepResponse) -> bool:
        """Adds a step; returns whether every episode has ended."""
        self._steps.append((seen, actions, reply))
        ended = (reply.terminated | reply.truncated) & (self._lengths == 0)
        self._lengths[ended] = len(self._steps)
        return bool(self._lengths.all())

    def episodes(self) -> tuple[Episode, ...]:
        return tuple(self._episode(env, int(length)) for env, length in enumerate(self._lengths))

    def _episode(self, env: int, length: int) -> Episode:
        steps = self._steps[:length]
        truths = [reply.truth for _, _, reply in steps if reply.truth is not None]
        return Episode(
            frames=np.stack([seen[env] for seen, _, _ in steps]),
            actions=np.stack([actions[env] for _, actions, _ in steps]),
            rewards=np.array([truth.reward[env] for truth in truths], np.float32),
            is_success=bool(truths and truths[-1].success[env]),
        )


def _view(frames: dict[str, Frames], camera: str, num_envs: int) -> Frames:
    return frames[camera] if camera else np.zeros((num_envs, 0, 0, 3), np.uint8)
