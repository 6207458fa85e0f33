"""Environments over the network: a task of one or several sim services, rewarded for what is seen.

Rewards are not waited for: frames of several steps are judged together, behind the steps that follow.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import ServiceError
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
    StepResponse,
)
from freerein_orchestrator.judges import Frames, Judge
from freerein_orchestrator.rejection import Rejected
from freerein_orchestrator.rollout import Actions, Rewards, Step

LEASE_S = 300.0
_FRAMES_PER_JUDGEMENT = 32
_CLOSE_TIMEOUT_S = 0.5


def split(num_envs: int, sims: int) -> tuple[int, ...]:
    """Returns how many environments each of several sims hosts: as evenly as can be, the first ones more."""
    return tuple(num_envs // sims + (index < num_envs % sims) for index in range(sims))


class ServedEnvironments:
    """N environments, of a session on each of several sims, seen by one camera.

    A session is lost with the process that hosts it: others, made with the last snapshots, go on from there.

    Args:
        sims: The services, `SyncClient`; at most N. Each hosts its share, with a seed of its own.
        request: The session, as if it were one.
        camera: Whose frames are observed; of the task's own size unless the session says otherwise.
        judge: Where rewards come from; called on a thread of its own.
        snapshots: Where to stand, one for each sim; before the first episode without.
        interrupt: Called before each step; what it raises ends the step.

    Raises:
        ServiceError: As every method: a service refused, could not be reached or did not answer in time.
    """

    def __init__(
        self,
        sims: Sequence[SyncClient],
        request: CreateSessionRequest,
        *,
        camera: str,
        judge: Judge,
        snapshots: Sequence[bytes] = (),
        interrupt: Callable[[], None] = lambda: None,
    ) -> None:
        shares = split(request.num_envs, len(sims))
        self.num_envs = request.num_envs
        self._cuts = np.cumsum(shares)[:-1]
        self._interrupt = interrupt
        self._closing = ExitStack()
        self._judging = _Judging(judge, steps=max(1, _FRAMES_PER_JUDGEMENT // request.num_envs))
        self._closing.callback(self._judging.close)
        self._stepping = ThreadPoolExecutor(len(sims), thread_name_prefix="sim")
        self._closing.callback(self._stepping.shutdown, wait=False)
        self._sessions: list[_Session] = []
        self._closing.callback(self._end_sessions)
        with ExitStack() as on_error:
            on_error.callback(self.close)
            for index, (sim, own) in enumerate(zip(sims, _share(request, shares), strict=True)):
                session = _Session.open(sim, own, camera=camera)
                self._sessions.append(session)
                if snapshots:
                    session.restore(snapshots[index])
            on_error.pop_all()

    def reset(self) -> Frames:
        """Begins an episode in every environment; returns their first frames, uint8 (N, H, W, C)."""
        return np.concatenate(list(self._stepping.map(_Session.reset, self._sessions)))

    def step(self, actions: Actions) -> Step:
        """Takes one action in every environment; what it came to will be judged."""
        self._interrupt()
        self._judging.check()
        parts = list(self._stepping.map(_Session.step, self._sessions, np.split(actions, self._cuts)))
        reached = np.concatenate([part.reached for part in parts])
        oracles = [part.oracle for part in parts if part.oracle is not None]
        self._judging.add(reached, np.concatenate(oracles) if oracles else None)
        return Step(
            observations=np.concatenate([part.shown for part in parts]),
            terminated=np.concatenate([part.terminated for part in parts]),
            truncated=np.concatenate([part.truncated for part in parts]),
            final_observations=reached,
        )

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since they were last asked for, float32 (T, N); waits for them."""
        return self._judging.finish().reshape(-1, self.num_envs)

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns where the environments stand, one for each sim."""
        return tuple(self._stepping.map(_Session.snapshot, self._sessions))

    def close(self) -> None:
        """Ends the sessions that can be reached; the others end with their leases."""
        self._closing.close()

    def _end_sessions(self) -> None:
        """Ends all at once, by threads of their own: those that step may hang."""
        with ThreadPoolExecutor(max(1, len(self._sessions)), thread_name_prefix="close") as ending:
            list(ending.map(_Session.close, self._sessions))


def _share(request: CreateSessionRequest, shares: Sequence[int]) -> list[CreateSessionRequest]:
    """Returns a request for each sim."""
    seeds = np.random.SeedSequence(request.seed).spawn(len(shares))
    return [
        replace(request, num_envs=count, seed=int(seed.generate_state(1)[0]), lease_s=LEASE_S)
        for count, seed in zip(shares, seeds, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Part:
    """What a step of one session's environments came to."""

    shown: Frames
    reached: Frames
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    oracle: Rewards | None


class _Session:
    """A session on one sim."""

    def __init__(self, sim: SyncClient, session: str, *, num_envs: int, camera: str) -> None:
        self._sim = sim
        self._session = session
        self._num_envs = num_envs
        self._camera = camera
        self._steps = 0

    @classmethod
    def open(cls, sim: SyncClient, request: CreateSessionRequest, *, camera: str) -> "_Session":
        session: str = sim.create_session(request).session
        return cls(sim, session, num_envs=request.num_envs, camera=camera)

    def restore(self, snapshot: bytes) -> None:
        self._steps = self._sim.restore(RestoreRequest(self._session, snapshot)).step_id

    def reset(self) -> Frames:
        frames = self._sim.reset(ResetRequest(self._session, cameras=(self._camera,))).frames
        return cast(Frames, frames[self._camera])

    def step(self, actions: Actions) -> _Part:
        request = StepRequest(self._session, self._steps + 1, actions, cameras=(self._camera,))
        reply: StepResponse = self._sim.step(request)
        self._steps += 1
        shown, over = reply.frames.get(self._camera), reply.terminated | reply.truncated
        last = reply.final_frames.get(self._camera)
        if shown is None or len(shown) != self._num_envs or len(over) != self._num_envs:
            raise _nonsense()
        reached = shown
        if over.any():
            if last is None or last.shape != (over.sum(), *shown.shape[1:]):
                raise _nonsense()
            reached = shown.copy()
            reached[over] = last
        oracle = None if reply.truth is None else reply.truth.reward
        return _Part(shown, reached, reply.terminated, reply.truncated, oracle)

    def snapshot(self) -> bytes:
        return cast(bytes, self._sim.snapshot(SnapshotRequest(self._session)).snapshot)

    def close(self) -> None:
        with suppress(ServiceError):
            self._sim.close_session(CloseSessionRequest(self._session), timeout_s=_CLOSE_TIMEOUT_S)


def _nonsense() -> Rejected:
    return Rejected(
        "The sim service must answer a frame for each environment, and one more for each episode that ended; "
        "it answered something else.",
        hint="Look at its log.",
    )


class _Judging:
    """Judges what steps came to, a few steps at a time and always the same ones together, behind the next steps."""

    def __init__(self, judge: Judge, *, steps: int) -> None:
        self._judge = judge
        self._steps = steps
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="judge")
        self._waiting: list[tuple[Frames, Rewards | None]] = []
        self._judged: list[Future[Rewards]] = []

    def add(self, reached: Frames, oracle: Rewards | None) -> None:
        self._waiting.append((reached, oracle))
        if len(self._waiting) == self._steps:
            self._send()

    def check(self) -> None:
        """Raises what a judgement has failed with, sooner than `finish` would."""
        for judged in self._judged:
            if judged.done():
                judged.result()

    def finish(self) -> Rewards:
        if self._waiting:
            self._send()
        judged, self._judged = self._judged, []
        return np.concatenate([each.result() for each in judged])

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _send(self) -> None:
        reached = np.concatenate([frames for frames, _ in self._waiting])
        oracles = [oracle for _, oracle in self._waiting if oracle is not None]
        self._waiting = []
        self._judged.append(self._thread.submit(self._ask, reached, np.concatenate(oracles) if oracles else None))

    def _ask(self, reached: Frames, oracle: Rewards | None) -> Rewards:
        rewards = self._judge(reached, oracle)
        if rewards.shape != (len(reached),):
            raise Rejected(
                f"Rewards must be one for each of {len(reached)} frames; got shape {rewards.shape}.",
                hint="Look at the log of the service that rewards come from.",
            )
        return rewards
