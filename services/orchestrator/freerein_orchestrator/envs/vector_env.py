"""Vectorised environments over the network: one task, hosted by one or several sim services.

Rewards are computed behind the steps that follow, for the frames of several steps together.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeVar, cast

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.errors import ServiceError
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    RenderRequest,
    ResetRequest,
    RestoreRequest,
    SnapshotRequest,
    StepRequest,
    StepResponse,
)
from freerein_orchestrator.envs.practice import Start
from freerein_orchestrator.rl.env_groups import EnvGroups
from freerein_orchestrator.rl.errors import IterationRejected
from freerein_orchestrator.rl.vec_env import Actions, CameraFrames, Frames, Rewards, VecStep, join_cameras, moments

T = TypeVar("T")

RewardFn: TypeAlias = Callable[[CameraFrames, Rewards | None], Rewards]
"""As `Reward.of_frames`."""

LEASE_S = 1800.0  # on a busy machine an object encoder is fitted for minutes between two calls
FRAMES_PER_REWARD_CALL = 32
_CLOSE_TIMEOUT_S = 0.5
_POLL_S = 0.1


def open_groups(
    sims: Sequence[SyncClient],
    request: CreateSessionRequest,
    *,
    cameras: Sequence[str],
    reward_fn: RewardFn,
    reward_cameras: Sequence[str] = (),
    action_repeat: int = 1,
    snapshots: Sequence[bytes] = (),
    interrupt: Callable[[], None] = lambda: None,
) -> "EnvGroups[RemoteVectorEnv]":
    """Opens environments in two groups that step in turn, or in one where each sim service hosts a single environment.

    Arguments and errors are those of `RemoteVectorEnv`. Snapshots are group after group; a group reads its first ones.
    """
    shares = envs_per_sim(request.num_envs, 2 if request.num_envs >= 2 * len(sims) else 1)
    per_group = len(snapshots) // len(shares)
    with ExitStack() as on_error:
        groups: list[RemoteVectorEnv] = []
        for index, own in enumerate(_split_request(request, shares)):
            group = RemoteVectorEnv(
                sims,
                own,
                cameras=cameras,
                reward_fn=reward_fn,
                reward_cameras=reward_cameras,
                action_repeat=action_repeat,
                snapshots=snapshots[index * per_group :][: min(per_group, len(sims))],
                interrupt=interrupt,
            )
            on_error.callback(group.close)
            groups.append(group)
        on_error.pop_all()
    return EnvGroups(groups)


def envs_per_sim(num_envs: int, sims: int) -> tuple[int, ...]:
    """Returns the number of environments per sim service, as even as possible."""
    return tuple(num_envs // sims + (index < num_envs % sims) for index in range(sims))


class RemoteVectorEnv:
    """N environments in one session per sim service. Observations are the frames of all cameras, on the channels.

    A session is lost with the process that hosts it; open others from the last snapshots.

    Args:
        sims: Clients of the sim services, at most N; each hosts its share, with a seed of its own.
        request: The session, as if it were one.
        cameras: The cameras that are observed, at least one, with frames of one height and width.
        reward_fn: Rewards frames; called on a thread of its own.
        reward_cameras: The cameras whose frames it is given; empty for those that are observed.
        action_repeat: Timesteps that each action is held for, or until the episode ends; the last is seen and rewarded.
        snapshots: One per sim service, to restore; empty for new episodes.
        interrupt: Called before each step and while waiting; raises to stop.

    Raises:
        ServiceError: As every method: a service refused, could not be reached or did not answer in time.
    """

    def __init__(
        self,
        sims: Sequence[SyncClient],
        request: CreateSessionRequest,
        *,
        cameras: Sequence[str],
        reward_fn: RewardFn,
        reward_cameras: Sequence[str] = (),
        action_repeat: int = 1,
        snapshots: Sequence[bytes] = (),
        interrupt: Callable[[], None] = lambda: None,
    ) -> None:
        shares = envs_per_sim(request.num_envs, len(sims))
        self.num_envs = request.num_envs
        self._cuts = np.cumsum(shares)[:-1]
        self._interrupt = interrupt
        self._closing = ExitStack()
        self._rewards = _RewardPipeline(reward_fn, steps=max(1, FRAMES_PER_REWARD_CALL // request.num_envs))
        self._closing.callback(self._rewards.close)
        self._stepping = ThreadPoolExecutor(len(sims), thread_name_prefix="sim")
        self._closing.callback(self._stepping.shutdown, wait=False)
        self._sessions: list[_Session] = []
        self._closing.callback(self._close_sessions)
        with ExitStack() as on_error:
            on_error.callback(self.close)
            for index, (sim, own) in enumerate(zip(sims, _split_request(request, shares), strict=True)):
                session = _Session(sim, own, cameras, reward_cameras or cameras, action_repeat)
                self._sessions.append(session)
                if snapshots:
                    session.restore(snapshots[index])
            on_error.pop_all()

    def reset(self) -> Frames:
        """Starts an episode in every environment; returns the first frames, uint8 (N, H, W, C)."""
        return np.concatenate(self._map(_Session.reset))

    def step(self, actions: Actions) -> VecStep:
        """Takes one action in every environment; its rewards are computed in the background."""
        self._interrupt()
        self._rewards.check()
        shares = cast(Sequence[Actions], np.split(actions, self._cuts))
        calls = [
            self._stepping.submit(session.sim.step, session.step_request(share))
            for session, share in zip(self._sessions, shares, strict=True)
        ]
        parts = [session.stepped(reply) for session, reply in zip(self._sessions, self._results(calls), strict=True)]
        oracles = [part.oracle for part in parts if part.oracle is not None]
        rewarded = _by_camera([part.rewarded for part in parts])
        self._rewards.add(rewarded, np.concatenate(oracles) if oracles else None)
        return VecStep(
            observations=np.concatenate([part.frames for part in parts]),
            terminated=np.concatenate([part.terminated for part in parts]),
            truncated=np.concatenate([part.truncated for part in parts]),
            final_observations=np.concatenate([part.final_frames for part in parts]),
        )

    def rewards(self) -> Rewards:
        """Returns the rewards of the T steps since the last call, float32 (T, N); waits for them."""
        return np.concatenate(self._results(self._rewards.finish())).reshape(-1, self.num_envs)

    def snapshots(self) -> tuple[bytes, ...]:
        """Returns snapshots of the environments, one per sim service."""
        return tuple(self._map(_Session.snapshot))

    def states(self) -> Sequence[Start]:
        """Returns the present state of each environment."""
        snapshots = self._map(_Session.snapshot)
        return [Start(own, env) for own, session in zip(snapshots, self._sessions, strict=True) for env in session.envs]

    def begin_at(self, starts: Mapping[int, Start]) -> Frames:
        """Sets environments to states of earlier ones, whose episodes go on there; returns all frames (N, H, W, C)."""
        first = np.cumsum([0, *(len(session.envs) for session in self._sessions)])
        own = {
            session: {env: starts[begin + env] for env in session.envs if begin + env in starts}
            for begin, session in zip(first.tolist(), self._sessions, strict=False)
        }
        return np.concatenate(self._map(lambda session: session.begin_at(own[session])))

    def close(self) -> None:
        """Closes the sessions that can be reached; the others expire with their leases."""
        self._closing.close()

    def _map(self, call: Callable[["_Session"], T]) -> list[T]:
        """Returns the results of a call to each session, all at once."""
        return self._results([self._stepping.submit(call, session) for session in self._sessions])

    def _results(self, futures: list[Future[T]]) -> list[T]:
        while wait(futures, _POLL_S).not_done:
            self._interrupt()
        return [future.result() for future in futures]

    def _close_sessions(self) -> None:
        """Closes all at once, on new threads: those that step may hang."""
        with ThreadPoolExecutor(max(1, len(self._sessions)), thread_name_prefix="close") as closing:
            list(closing.map(_Session.close, self._sessions))


def _split_request(request: CreateSessionRequest, shares: Sequence[int]) -> list[CreateSessionRequest]:
    """Returns the request of each sim service."""
    seeds = np.random.SeedSequence(request.seed).spawn(len(shares))
    return [
        replace(request, num_envs=count, seed=int(seed.generate_state(1)[0]), lease_s=LEASE_S)
        for count, seed in zip(shares, seeds, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _SessionStep:
    """One step of one session.

    Attributes:
        frames: Those that are observed, uint8 (N, H, W, C).
        final_frames: The same, but the last of the old episode where one ended.
        rewarded: Likewise, of the reward's cameras.
    """

    frames: Frames
    final_frames: Frames
    rewarded: CameraFrames
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    oracle: Rewards | None


class _Session:
    """A session on one sim service."""

    def __init__(
        self,
        sim: SyncClient,
        request: CreateSessionRequest,
        cameras: Sequence[str],
        reward_cameras: Sequence[str],
        action_repeat: int,
    ) -> None:
        self.sim = sim
        self._session: str = sim.create_session(request).session
        self.envs = range(request.num_envs)
        self._cameras, self._reward_cameras = tuple(cameras), tuple(reward_cameras)
        self._rendered = tuple(dict.fromkeys((*cameras, *reward_cameras)))
        self._action_repeat = action_repeat
        self._steps = 0

    def restore(self, snapshot: bytes) -> None:
        self._steps = self.sim.restore(RestoreRequest(self._session, snapshot)).step_id

    def begin_at(self, starts: Mapping[int, Start]) -> Frames:
        """Sets environments to states, those of one snapshot at once; returns the frames of all."""
        for snapshot in dict.fromkeys(start.snapshot for start in starts.values()):
            chosen = {env: start.env for env, start in starts.items() if start.snapshot == snapshot}
            self.sim.restore(RestoreRequest(self._session, snapshot, tuple(chosen), tuple(chosen.values())))
        return self._observed(self.sim.render(RenderRequest(self._session, self._cameras)).frames)

    def reset(self) -> Frames:
        return self._observed(self.sim.reset(ResetRequest(self._session, cameras=self._cameras)).frames)

    def step_request(self, actions: Actions) -> StepRequest:
        cameras, repeat = self._rendered, self._action_repeat
        return StepRequest(self._session, self._steps + 1, actions, cameras=cameras, action_repeat=repeat)

    def stepped(self, reply: StepResponse) -> _SessionStep:
        """Returns a step, given the reply to its request. Raises IterationRejected where that is malformed."""
        self._steps += 1
        final = {camera: self._final(reply, camera) for camera in self._rendered}
        return _SessionStep(
            self._observed(reply.frames),
            self._observed(final),
            {camera: final[camera] for camera in self._reward_cameras},
            reply.terminated,
            reply.truncated,
            None if reply.truth is None else reply.truth.reward,
        )

    def _final(self, reply: StepResponse, camera: str) -> Frames:
        """Returns the frames that a step led to: the last of the old episode where one ended."""
        frames = reply.frames.get(camera)
        if frames is None or {len(frames), len(reply.terminated), len(reply.truncated)} != {len(self.envs)}:
            raise _malformed()
        done = reply.terminated | reply.truncated
        if not done.any():
            return frames
        last = reply.final_frames.get(camera)
        if last is None or last.shape != (done.sum(), *frames.shape[1:]):
            raise _malformed()
        final = frames.copy()
        final[done] = last
        return final

    def _observed(self, frames: CameraFrames) -> Frames:
        """Returns the frames of the observed cameras, side by side on the channels."""
        return join_cameras(frames, self._cameras)

    def snapshot(self) -> bytes:
        return self.sim.snapshot(SnapshotRequest(self._session)).snapshot

    def close(self) -> None:
        with suppress(ServiceError):
            self.sim.close_session(CloseSessionRequest(self._session), timeout_s=_CLOSE_TIMEOUT_S)


def _by_camera(parts: Sequence[CameraFrames]) -> CameraFrames:
    """Returns the frames of several sessions or steps as one, by camera."""
    return {camera: np.concatenate([part[camera] for part in parts]) for camera in parts[0]}


def _malformed() -> IterationRejected:
    return IterationRejected(
        "The sim service must return a frame per environment, and a final one per episode that ended; it did not.",
        hint="See its log.",
    )


class _RewardPipeline:
    """Computes rewards on a thread of its own, always for the same few steps together."""

    def __init__(self, reward_fn: RewardFn, *, steps: int) -> None:
        self._reward_fn = reward_fn
        self._steps = steps
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="reward")
        self._pending: list[tuple[CameraFrames, Rewards | None]] = []
        self._submitted: list[Future[Rewards]] = []

    def add(self, frames: CameraFrames, oracle: Rewards | None) -> None:
        self._pending.append((frames, oracle))
        if len(self._pending) == self._steps:
            self._submit()

    def check(self) -> None:
        """Raises the error of a call that has failed, earlier than `finish` would."""
        for future in self._submitted:
            if future.done():
                future.result()

    def finish(self) -> list[Future[Rewards]]:
        """Returns the rewards of all steps since the last call."""
        if self._pending:
            self._submit()
        submitted, self._submitted = self._submitted, []
        return submitted

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _submit(self) -> None:
        frames = _by_camera([frames for frames, _ in self._pending])
        oracles = [oracle for _, oracle in self._pending if oracle is not None]
        self._pending = []
        self._submitted.append(self._thread.submit(self._call, frames, np.concatenate(oracles) if oracles else None))

    def _call(self, frames: CameraFrames, oracle: Rewards | None) -> Rewards:
        rewards, count = self._reward_fn(frames, oracle), moments(frames)
        if rewards.shape != (count,):
            raise IterationRejected(
                f"Rewards must be one per frame, of {count}; got shape {rewards.shape}.",
                hint="See the log of the service that computes rewards.",
            )
        return rewards
