"""One session: its worker, its lease and its last step."""

import asyncio
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from freerein.errors import FailedPrecondition, SessionNotFound, StepOutOfOrder, must_be
from freerein.types import sim
from freerein_sim.workers.protocol import MAX_ENVS, check_frames
from freerein_sim.workers.worker import Worker
from freerein_sim.worlds.world import MAX_EPISODE_STEPS

DEFAULT_LEASE_S = 60.0
MAX_LEASE_S = 3600.0
_SEED_BITS = 53  # exact in JSON of any language


@dataclass(eq=False)
class Session:
    """An open session.

    Attributes:
        request: The request that created it, with its defaults filled in.
        expires_at: End of its lease, on the service's clock.
        step_id: Number of steps made.
        last_step: Request and response of the last step, to answer its repetition.
        lock: Held by the call in progress.
    """

    id: str
    request: sim.CreateSessionRequest
    task: sim.Task
    worker: Worker
    expires_at: float
    step_id: int = 0
    last_step: tuple[sim.StepRequest, sim.StepResponse] | None = None
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)

    def check_frames(self, cameras: Sequence[str], *, height: int = 0, width: int = 0, times: int = 1) -> None:
        """Checks the size of a reply with `times` frames of every environment and camera."""
        height, width = height or self.request.height, width or self.request.width
        check_frames(self.task, cameras, height=height, width=width, images=times * self.request.num_envs)

    def check_privileged(self, call: str) -> None:
        """Raises FailedPrecondition if the session does not read the true state."""
        if not self.request.privileged:
            raise FailedPrecondition(
                f"{call} reads the true state, for evaluation: it needs a privileged session; this one is not.",
                field="session",
                hint="Create a session with `privileged`.",
            )

    def recorded_response(self, request: sim.StepRequest) -> sim.StepResponse | None:
        """Returns the response to the last step if this repeats it, None if this is the next step."""
        if self.last_step is not None and request.step_id == self.step_id:
            last, response = self.last_step
            if not _is_repeated(request, last):
                raise StepOutOfOrder(
                    f"Step {request.step_id} was made already; got it again with other actions, cameras or repeats.",
                    field="step_id",
                    hint="Repeat a step only unchanged. The next step's `step_id` is one more.",
                )
            return response
        if request.step_id != self.step_id + 1:
            raise StepOutOfOrder(
                f"`step_id` must be {self.step_id + 1}, one more than the last; got {request.step_id}.",
                field="step_id",
                hint="Count from 1; `Reset` does not restart the count, `Restore` returns the step to go on from.",
            )
        return None


def with_defaults(request: sim.CreateSessionRequest, task: sim.Task) -> sim.CreateSessionRequest:
    """Returns the request with its defaults filled in, after checking its values."""
    check_frames(task, (), height=request.height, width=request.width, images=0)
    num_envs, lease_s = request.num_envs or 1, request.lease_s or DEFAULT_LEASE_S
    if not 1 <= num_envs <= MAX_ENVS:
        raise must_be("num_envs", f"1 to {MAX_ENVS}", num_envs)
    if not 0 < lease_s <= MAX_LEASE_S:
        raise must_be("lease_s", f"above 0 and at most {MAX_LEASE_S:.0f} seconds", f"{lease_s:g}")
    max_episode_steps = request.max_episode_steps or task.max_episode_steps
    if max_episode_steps > MAX_EPISODE_STEPS:
        raise must_be("max_episode_steps", f"at most {MAX_EPISODE_STEPS}", max_episode_steps)
    seed = secrets.randbits(_SEED_BITS) if request.seed is None else request.seed
    return replace(request, num_envs=num_envs, lease_s=lease_s, seed=seed, max_episode_steps=max_episode_steps)


def session_not_found() -> SessionNotFound:
    """Returns the error for an unknown session."""
    return SessionNotFound(
        "There is no such session: it was never made, was closed, or its lease has ended.",
        field="session",
        hint="Create one. Any call renews its lease.",
    )


def _is_repeated(request: sim.StepRequest, last: sim.StepRequest) -> bool:
    return (
        (request.cameras, request.action_repeat) == (last.cameras, last.action_repeat)
        and request.actions.dtype == last.actions.dtype
        and request.actions.shape == last.actions.shape
        and request.actions.tobytes() == last.actions.tobytes()
    )
