"""What the sim service takes and returns. In the shapes, N is the number of environments of the session."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera, Draining, Error, Trajectory

Behaviour = Literal["expert", "random"]
Frames = dict[str, npt.NDArray[np.uint8]]
"""By camera: uint8 (N, H, W, C)."""


@dataclass(frozen=True)
class Task:
    """A world with a goal and an oracle.

    Attributes:
        name: Its name.
        world: The world's name.
        goal_text: What is to be done, in words; empty for a task without a goal.
        cameras: The cameras.
        action: The action.
        control_dt_s: Time between two actions, in seconds.
        skills: The skills that its expert can execute.
        max_episode_steps: Steps after which an episode is truncated.
        snapshots: Whether Snapshot and Restore work, bit for bit.
    """

    name: str
    world: str
    goal_text: str
    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    skills: tuple[str, ...]
    max_episode_steps: int
    snapshots: bool


@dataclass(frozen=True)
class ListTasksRequest:
    """Asks for the tasks."""


@dataclass(frozen=True)
class ListTasksResponse:
    """The tasks, by name."""

    tasks: tuple[Task, ...]


@dataclass(frozen=True)
class CreateSessionRequest:
    """What a session is to be.

    Attributes:
        task: The task's name.
        num_envs: Environments, stepped together; 0 means 1.
        seed: Environment i draws from SeedSequence(seed).spawn(num_envs)[i]; None for a seed drawn by the server.
        lease_s: The session ends when no call touched it for this many seconds; 0 means 60.
        height: Height of frames, in pixels; 0 means the cameras' own.
        width: Width of frames, in pixels; 0 means the cameras' own.
        privileged: Whether replies hold `Truth`. For evaluation only.
        idempotency_key: The same key and request returns the session already made; empty for none.
    """

    task: str
    num_envs: int = 0
    seed: int | None = None
    lease_s: float = 0.0
    height: int = 0
    width: int = 0
    privileged: bool = False
    idempotency_key: str = ""


@dataclass(frozen=True)
class CreateSessionResponse:
    """The session.

    Attributes:
        session: 32 hexadecimal digits.
        seed: The seed in use.
        num_envs: Environments.
        task: What the session's task is.
        lease_s: Seconds without a call after which it ends.
    """

    session: str
    seed: int
    num_envs: int
    task: Task
    lease_s: float


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true in the simulator: for evaluation, never for learning.

    Attributes:
        state: float64 (N, S), the task's state.
        reward: float32 (N,), the oracle's reward of the last step.
        success: bool (N,), whether the goal holds.
    """

    state: npt.NDArray[np.float64]
    reward: npt.NDArray[np.float32]
    success: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ResetRequest:
    """Asks for new episodes.

    Attributes:
        session: The session.
        envs: Which environments; empty for all.
        seed: Seeds the generators anew before the reset; None lets them go on.
        cameras: The cameras to render; empty for no pixels.
    """

    session: str
    envs: tuple[int, ...] = ()
    seed: int | None = None
    cameras: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ResetResponse:
    """The first observations.

    Attributes:
        frames: By camera: uint8 (N, H, W, C), all environments.
        truth: Only in a privileged session.
    """

    frames: Frames
    truth: Truth | None = None


@dataclass(frozen=True, eq=False)
class StepRequest:
    """One action for each environment.

    Attributes:
        session: The session.
        step_id: 1 for the session's first step, then one more each time; the last one repeated returns the recorded
            reply.
        actions: float32 or int64 (N, size), as the task's `ActionSpec` says.
        cameras: The cameras to render; empty for no pixels.
    """

    session: str
    step_id: int
    actions: npt.NDArray[Any]
    cameras: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StepResponse:
    """What came of a step. An environment whose episode ended is reset in the same step.

    Attributes:
        step_id: The request's.
        frames: By camera: uint8 (N, H, W, C); of the new episode where one ended.
        reward: float32 (N,), always 0: the oracle's reward is in `truth`.
        terminated: bool (N,), the episode reached an end of its own.
        truncated: bool (N,), the episode was cut at its longest.
        diverged: bool (N,), the simulation diverged; then `terminated` is true as well.
        final_frames: By camera: uint8 (M, H, W, C), the last frame of each of the M episodes that ended, in order.
        truth: Only in a privileged session; of the state before any reset.
    """

    step_id: int
    frames: Frames
    reward: npt.NDArray[np.float32]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    diverged: npt.NDArray[np.bool_]
    final_frames: Frames
    truth: Truth | None = None


@dataclass(frozen=True, eq=False)
class ConnectRequest:
    """One message of a stepping stream: exactly one of the two."""

    step: StepRequest | None = None
    reset: ResetRequest | None = None


@dataclass(frozen=True, eq=False)
class ConnectResponse:
    """One reply of a stepping stream: exactly one of the four."""

    step: StepResponse | None = None
    reset: ResetResponse | None = None
    error: Error | None = None
    draining: Draining | None = None


@dataclass(frozen=True)
class RenderRequest:
    """Asks for pixels.

    Attributes:
        session: The session.
        cameras: The cameras; empty for all of the task.
        height: Height, in pixels; 0 means the session's.
        width: Width, in pixels; 0 means the session's.
    """

    session: str
    cameras: tuple[str, ...] = ()
    height: int = 0
    width: int = 0


@dataclass(frozen=True, eq=False)
class RenderResponse:
    """The pixels, by camera: uint8 (N, H, W, C)."""

    frames: Frames


@dataclass(frozen=True)
class SnapshotRequest:
    """Asks for a session's state."""

    session: str


@dataclass(frozen=True)
class SnapshotResponse:
    """A session's state: opaque, and restored on the same build of the same world only."""

    snapshot: bytes


@dataclass(frozen=True)
class RestoreRequest:
    """Asks to put a session into the state of a snapshot.

    Attributes:
        session: The session; of the snapshot's task and number of environments.
        snapshot: As Snapshot returned it.
    """

    session: str
    snapshot: bytes


@dataclass(frozen=True)
class RestoreResponse:
    """The session is as it was; `step_id` is the last step made before the snapshot."""

    step_id: int


@dataclass(frozen=True)
class DemonstrateRequest:
    """What to demonstrate.

    Attributes:
        task: The task's name.
        behaviour: Who acts.
        skills: The skills to choose from; empty for all of the task.
        min_skills: Fewest different skills in one trajectory; 0 means 1.
        max_skills: Most different skills in one trajectory; 0 means as many as `skills`.
        count: Trajectories.
        seed: Trajectory i is drawn from SeedSequence(seed).spawn(count)[i].
        first: Index of the first trajectory to send.
        cameras: The cameras to record; empty for the task's first.
        height: Height, in pixels; 0 means the camera's own.
        width: Width, in pixels; 0 means the camera's own.
        privileged: Whether replies hold `labels`. For evaluation only.
    """

    task: str
    behaviour: Behaviour
    skills: tuple[str, ...] = ()
    min_skills: int = 0
    max_skills: int = 0
    count: int = 1
    seed: int = 0
    first: int = 0
    cameras: tuple[str, ...] = ()
    height: int = 0
    width: int = 0
    privileged: bool = False


@dataclass(frozen=True, eq=False)
class DemonstrateResponse:
    """One trajectory.

    Attributes:
        index: Counts from the request's `first`.
        trajectory: What was seen and done, and which skills occur.
        labels: int64 (T,), the skill in execution as an index into the task's skills; empty unless privileged.
    """

    index: int
    trajectory: Trajectory
    labels: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True)
class CloseSessionRequest:
    """Asks to end a session."""

    session: str


@dataclass(frozen=True)
class CloseSessionResponse:
    """It is ended."""
