"""Environments over the network: a task of the sim service, rewarded for what is seen."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt

from freerein.clients import Synchronous
from freerein.errors import FailedPrecondition
from freerein.types.common import ModelRef
from freerein.types.reward import RewardRequest
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
from freerein_orchestrator.rollout import Actions, Step

Frames: TypeAlias = npt.NDArray[np.uint8]
Judge: TypeAlias = Callable[[Frames, Truth | None], npt.NDArray[np.float32]]
"""Given what each of N environments came to, uint8 (N, H, W, C), returns the rewards, float32 (N,).

The truth beside it is there in a privileged session only.
"""


@dataclass(frozen=True)
class LearnedReward:
    """The reward service's: 1 where the goal text beats its rivals, else 0.

    Attributes:
        reward: The service, `Synchronous`.
        goal_text: What is to be seen.
        camera: Whose frames the environments show.
        model: Which model judges.
    """

    reward: Synchronous
    goal_text: str
    camera: str
    model: ModelRef = ModelRef()

    def __call__(self, reached: Frames, _truth: Truth | None) -> npt.NDArray[np.float32]:
        """Returns the rewards."""
        request = RewardRequest(self.goal_text, {self.camera: reached}, model=self.model)
        return cast(npt.NDArray[np.float32], self.reward.reward(request).rewards)


def oracle(_reached: Frames, truth: Truth | None) -> npt.NDArray[np.float32]:
    """Returns the task's own reward, which no learner without privileges has: to compare with.

    Raises:
        FailedPrecondition: The session is not privileged.
    """
    if truth is None:
        raise FailedPrecondition(
            "The oracle's reward needs a privileged session; this one is not.", hint="Ask for a learned reward."
        )
    return truth.reward


class ServedEnvironments:
    """N environments of one session, seen by one camera.

    A session is lost with the process that hosts it: others, made with its last snapshot, go on from there.

    Args:
        sim: The service, `Synchronous`.
        request: The session.
        camera: Whose frames are observed; of the task's own size unless the session says otherwise.
        judge: Where rewards come from.
        snapshot: Where to stand; before the first episode without.

    Raises:
        ServiceError: As every method: the service refused, could not be reached or did not answer in time.
    """

    def __init__(
        self, sim: Synchronous, request: CreateSessionRequest, *, camera: str, judge: Judge, snapshot: bytes = b""
    ) -> None:
        self._sim = sim
        self._request = request
        self._cameras = (camera,)
        self._judge = judge
        self._session: str = sim.create_session(request).session
        self._steps: int = sim.restore(RestoreRequest(self._session, snapshot)).step_id if snapshot else 0

    @property
    def num_envs(self) -> int:
        """N."""
        return self._request.num_envs

    def reset(self) -> Frames:
        """Begins an episode in every environment; returns their first frames, uint8 (N, H, W, C)."""
        return self._only(self._sim.reset(ResetRequest(self._session, cameras=self._cameras)).frames)

    def step(self, actions: Actions) -> Step:
        """Takes one action in every environment, and has what it came to judged."""
        request = StepRequest(self._session, self._steps + 1, actions, cameras=self._cameras)
        reply: StepResponse = self._sim.step(request)
        self._steps += 1
        shown = self._only(reply.frames)
        reached = shown.copy()
        reached[reply.terminated | reply.truncated] = self._only(reply.final_frames)
        rewards = self._judge(reached, reply.truth)
        return Step(shown, rewards, reply.terminated, reply.truncated, reached)

    def snapshot(self) -> bytes:
        """Returns where the environments stand."""
        return cast(bytes, self._sim.snapshot(SnapshotRequest(self._session)).snapshot)

    def close(self) -> None:
        """Ends the session."""
        self._sim.close_session(CloseSessionRequest(self._session))

    def _only(self, frames: dict[str, Frames]) -> Frames:
        return frames[self._cameras[0]]
