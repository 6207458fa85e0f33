"""Requests and responses of the sim service. N is the number of environments of the session."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera, Draining, Error, Trajectory

Behaviour = Literal["expert", "random"]
CameraFrames = dict[str, npt.NDArray[np.uint8]]
"""By camera: uint8 (N, H, W, C)."""


@dataclass(frozen=True)
class Predicate:
    """A statement about true states, for evaluation.

    Attributes:
        name: One that worlds share, such as `at-landmark` (see the contract), or one of the world's own.
        text: What it states, as a caption; empty where no image could show it.
        group: Predicates of one group exclude each other: at most one holds in a state. Empty for no group.
        needs_reference: Whether it compares each state with a reference, such as a landmark's state.
    """

    name: str
    text: str = ""
    group: str = ""
    needs_reference: bool = False


@dataclass(frozen=True)
class Measure:
    """A number of true states, in a physical unit if it has one; it may compare each state with a reference."""

    name: str
    unit: str = ""
    needs_reference: bool = False


@dataclass(frozen=True)
class Task:
    """A world with an optional goal and its oracle.

    Attributes:
        goal_text, skills: Goal in words, and the expert's skills; empty for a task without a goal, or an expert.
        max_episode_steps: Steps after which an episode is truncated.
        conditions: Named variations with which a session can be created.
        min_skills, max_skills: Fewest and most skills of a recipe; conditions may allow fewer.
        has_explorer, reward_free: Whether its random exploration is its own; whether every reward is 0.
    """

    name: str
    world: str
    goal_text: str
    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    skills: tuple[str, ...]
    max_episode_steps: int
    predicates: tuple[Predicate, ...] = ()
    has_expert: bool = False
    conditions: tuple[str, ...] = ()
    min_skills: int = 0
    max_skills: int = 0
    has_explorer: bool = False
    measures: tuple[Measure, ...] = ()
    reward_free: bool = False


@dataclass(frozen=True)
class ListTasksRequest:
    """Asks for the tasks."""


@dataclass(frozen=True)
class ListTasksResponse:
    """The tasks, by name."""

    tasks: tuple[Task, ...]


@dataclass(frozen=True)
class CreateSessionRequest:
    """Creates a session.

    Attributes:
        num_envs: Number of environments, stepped together; 0 means 1.
        seed: Environment i draws from SeedSequence(seed).spawn(num_envs)[i]; None: the server draws a seed.
        lease_s: Time without a call after which the session ends, in seconds; 0 means 60.
        height, width: Frame size in pixels; 0 means the cameras' own.
        privileged: Whether replies include `Truth`; for evaluation only.
        idempotency_key: The same key and request returns the session already created; empty for none.
        conditions: Conditions of the task, at most one of each group, in any order; empty for the nominal task.
        max_episode_steps: Steps after which an episode is truncated; 0 means the task's own.
    """

    task: str
    num_envs: int = 0
    seed: int | None = None
    lease_s: float = 0.0
    height: int = 0
    width: int = 0
    privileged: bool = False
    idempotency_key: str = ""
    conditions: tuple[str, ...] = ()
    max_episode_steps: int = 0


@dataclass(frozen=True)
class CreateSessionResponse:
    """The session: its id of 32 hexadecimal digits, and the values in use."""

    session: str
    seed: int
    num_envs: int
    task: Task
    lease_s: float


@dataclass(frozen=True, eq=False)
class Truth:
    """True state and oracle reward, for evaluation only.

    Attributes:
        state: float64 (N, S), true state.
        reward: float32 (N,), oracle reward of the last step.
        success: bool (N,), whether the goal holds.
    """

    state: npt.NDArray[np.float64]
    reward: npt.NDArray[np.float32]
    success: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Recipe:
    """Skills in order."""

    skills: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResetRequest:
    """Begins new episodes.

    Attributes:
        envs, cameras: Environments to reset, empty for all; cameras to render, empty for no frames.
        seed: Re-seeds the generators before the reset; None keeps them.
        recipes: What each environment's episode requires, if it is reset; empty for what the world draws.
    """

    session: str
    envs: tuple[int, ...] = ()
    seed: int | None = None
    cameras: tuple[str, ...] = ()
    recipes: tuple[Recipe, ...] = ()


@dataclass(frozen=True, eq=False)
class ResetResponse:
    """The first observations of all environments; `truth` only in a privileged session."""

    frames: CameraFrames
    truth: Truth | None = None


@dataclass(frozen=True, eq=False)
class StepRequest:
    """One action for each environment.

    Attributes:
        step_id: 1 for the first step, then one more each time; the last one repeated returns its reply.
        actions, cameras: float32 or int64 (N, size), as the task's `ActionSpec` says; cameras to render, if any.
        action_repeat: Timesteps that each action is held for, or until the episode ends; 0 means 1.
    """

    session: str
    step_id: int
    actions: npt.NDArray[Any]
    cameras: tuple[str, ...] = ()
    action_repeat: int = 1


@dataclass(frozen=True, eq=False)
class StepResponse:
    """Result of a step. An environment whose episode ended is reset in the same step.

    Attributes:
        frames: By camera: uint8 (N, H, W, C); of the new episode where one ended.
        reward: float32 (N,), always 0: the oracle reward is in `truth`.
        terminated, truncated: bool (N,), whether the episode terminated, or was truncated at `max_episode_steps`.
        diverged: bool (N,), whether the simulation diverged; `terminated` is then true, too.
        final_frames: By camera: uint8 (M, H, W, C), the last frame of each of the M episodes that ended, in order.
        truth: Only in a privileged session; of the state before any reset.
    """

    step_id: int
    frames: CameraFrames
    reward: npt.NDArray[np.float32]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]
    diverged: npt.NDArray[np.bool_]
    final_frames: CameraFrames
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
    """Renders without stepping; no cameras means all of the task, a height or width of 0 pixels the session's."""

    session: str
    cameras: tuple[str, ...] = ()
    height: int = 0
    width: int = 0


@dataclass(frozen=True, eq=False)
class RenderResponse:
    """The frames, by camera: uint8 (N, H, W, C)."""

    frames: CameraFrames


@dataclass(frozen=True)
class SnapshotRequest:
    """Asks for a session's complete state."""

    session: str


@dataclass(frozen=True)
class SnapshotResponse:
    """A session's state: opaque; can be restored by the same build of the same world only."""

    snapshot: bytes


@dataclass(frozen=True)
class RestoreRequest:
    """Restores a snapshot into a session of the same task and conditions.

    Attributes:
        envs: Environments to restore, each once; they keep their generators, all else stays. Empty for the whole one.
        sources: For each of `envs`, which environment of the snapshot it goes on as; several may go on as one.
    """

    session: str
    snapshot: bytes
    envs: tuple[int, ...] = ()
    sources: tuple[int, ...] = ()


@dataclass(frozen=True)
class RestoreResponse:
    """The session is restored; `step_id` is the last step before the snapshot, with `envs` the session's last."""

    step_id: int


@dataclass(frozen=True)
class DemonstrateRequest:
    """Records trajectories of a scripted policy.

    Attributes:
        skills, min_skills, max_skills: To choose from, empty for all; fewest and most in one, 0 for those of recipes.
        count, seed: Trajectory i is drawn from SeedSequence(seed).spawn(count)[i].
        first, cameras: Index of the first trajectory to send; cameras to record, empty for the task's first.
        height, width, settle: Frame size in pixels, 0 for the camera's own; timesteps that the expert holds when done.
        privileged, conditions: Whether replies include `labels`, for evaluation only; as of `CreateSessionRequest`.
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
    conditions: tuple[str, ...] = ()
    settle: int = 0


@dataclass(frozen=True, eq=False)
class DemonstrateResponse:
    """One trajectory.

    Attributes:
        labels: int64 (T,), index of the skill at each timestep, into the task's skills; empty unless privileged.
    """

    index: int
    trajectory: Trajectory
    labels: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True)
class DrawRecipesRequest:
    """Draws `count` recipes of a task: recipe i is that of trajectory i of the `DemonstrateRequest` of equal fields."""

    task: str
    count: int = 1
    seed: int = 0
    skills: tuple[str, ...] = ()
    min_skills: int = 0
    max_skills: int = 0
    conditions: tuple[str, ...] = ()


@dataclass(frozen=True)
class DrawRecipesResponse:
    """The recipes, in the order in which they were drawn."""

    recipes: tuple[Recipe, ...]


@dataclass(frozen=True, eq=False)
class CheckRequest:
    """Asks a privileged session where a predicate of its task holds, or what a measure of it is.

    Attributes:
        states: float64 (N, T, S), true states of N sequences of T timesteps.
        references: float64 (N, T, S), what each is compared with; only where one is needed.
    """

    session: str
    predicate: str
    states: npt.NDArray[np.float64]
    references: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class CheckResponse:
    """Where the predicate holds at each timestep, given the sequence up to there, or what the measure is: (N, T)."""

    holds: npt.NDArray[np.bool_] | None = None
    values: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class ExpertActionsRequest:
    """Asks a privileged session for a scripted policy's next actions; to be called once before each step.

    `recipes` has one of each environment, read by the first call of its episode; empty for the episode's own.
    """

    session: str
    recipes: tuple[Recipe, ...] = ()
    behaviour: Behaviour = "expert"


@dataclass(frozen=True, eq=False)
class ExpertActionsResponse:
    """The policy's actions in the current states.

    Attributes:
        actions: float32 or int64 (N, size); 0 where the policy has finished.
        finished: bool (N,), whether the policy has finished.
        skills: int64 (N,), index of the skill that the action belongs to, into the task's skills; -1 for none.
    """

    actions: npt.NDArray[Any]
    finished: npt.NDArray[np.bool_]
    skills: npt.NDArray[np.int64]


@dataclass(frozen=True)
class CloseSessionRequest:
    """Closes a session."""

    session: str


@dataclass(frozen=True)
class CloseSessionResponse:
    """The session is closed."""
