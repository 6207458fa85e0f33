"""What a world is: something that can be reset, stepped, looked at, saved and put back, bit for bit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

import freerein.types.sim
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Camera, check_name

Action = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""float32 (A,) in [-1, 1] where the world is continuous, int64 (1,) where it is discrete; (T, A) for T timesteps."""

Frame = npt.NDArray[np.uint8]
"""uint8 (H, W, C), RGB."""

NO_SKILL = -1
"""The label of a timestep in which no skill is executed."""


@dataclass(frozen=True)
class WorldSpec:
    """What a world offers.

    Attributes:
        cameras: Its cameras, each with the size rendered by default; the first is the one to use when one must do.
        action: What an action is.
        control_dt_s: Time between two actions, in seconds.
        skills: The skills that its expert can execute; labels index into it.
        max_episode_steps: Steps after which the caller truncates an episode.
        state_names: What each number of the true state is.
        exact_snapshots: Whether `snapshot` and `restore` work, bit for bit.
        max_size: Greatest height and width of a frame, in pixels.
    """

    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    skills: tuple[str, ...]
    max_episode_steps: int
    state_names: tuple[str, ...]
    exact_snapshots: bool = True
    max_size: int = 256


@dataclass(frozen=True)
class StepResult:
    """What came of a step.

    Attributes:
        terminated: The episode reached an end of its own. Truncation is the caller's to count.
        diverged: The simulation diverged; then `terminated` is true as well.
    """

    terminated: bool
    diverged: bool = False


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What is true now: for evaluation, never for learning.

    Attributes:
        state: float64 (S,), named by the spec's `state_names`.
        reward: The oracle's reward of this state.
        success: Whether the task's goal holds in this state.
    """

    state: npt.NDArray[np.float64]
    reward: float
    success: bool


@dataclass(frozen=True, eq=False)
class LabelledAction:
    """What a behaviour does in one timestep.

    Attributes:
        action: The action to take.
        skill: Index of the skill in execution, `NO_SKILL` when there is none.
    """

    action: Action
    skill: int


class ScriptedPolicy(Protocol):
    """Somebody who acts in a world. It may read the world's true state; a learner never does."""

    def act(self) -> LabelledAction | None:
        """Returns what to do in this timestep, None when there is nothing left to do."""

    def succeeded(self) -> bool:
        """Returns whether everything that was asked of it has been done."""


class World(Protocol):
    """One environment. Not for use by two threads; `render` and `close` belong to one thread."""

    @property
    def spec(self) -> WorldSpec:
        """What the world offers."""

    @property
    def fingerprint(self) -> str:
        """A hash of everything that a snapshot relies on; snapshots go only between equal fingerprints."""

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Begins an episode.

        Args:
            rng: Draws the first state.
            recipe: The skills that the episode is about, in order, where the world shows them; empty lets the world
                choose.

        Raises:
            InvalidInput: The recipe names a skill that the world does not have.
        """

    def step(self, action: Action) -> StepResult:
        """Takes one action and lets `control_dt_s` pass.

        Raises:
            InvalidInput: The action is not what the spec says.
        """

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns what a camera sees now, in an array of its own.

        Raises:
            InvalidInput: There is no such camera, or the size is out of bounds.
            Unimplemented: This machine cannot render.
        """

    def snapshot(self) -> bytes:
        """Returns the complete state: restored, the same actions give the same bits."""

    def restore(self, snapshot: bytes) -> None:
        """Puts the world into the state of a snapshot of an equal fingerprint.

        Raises:
            InvalidInput: The bytes are not a snapshot of this world; the world is then as before.
        """

    def truth(self) -> GroundTruth:
        """Returns what is true now."""

    def expert(self, skills: Sequence[str], rng: np.random.Generator) -> ScriptedPolicy:
        """Returns somebody who executes the skills in order, from the state of now.

        Raises:
            InvalidInput: There is no such skill.
        """

    def close(self) -> None:
        """Frees what the world holds. Closing twice is fine."""


@dataclass(frozen=True)
class TaskDefinition:
    """A world with a goal and an oracle.

    Attributes:
        name: Its name, `^[a-z0-9][a-z0-9._-]{0,63}$`.
        world: The world's name.
        goal_text: What is to be done, in words; empty for a task without a goal.
        spec: What its worlds offer; known without building one.
        make: Builds a world, in need of a `reset`.
    """

    name: str
    world: str
    goal_text: str
    spec: WorldSpec
    make: Callable[[], World]

    def __post_init__(self) -> None:
        check_name(self.name, field="task")
        check_name(self.world, field="world")

    def describe(self) -> freerein.types.sim.Task:
        """Returns the task as clients see it."""
        return freerein.types.sim.Task(
            name=self.name,
            world=self.world,
            goal_text=self.goal_text,
            cameras=self.spec.cameras,
            action=self.spec.action,
            control_dt_s=self.spec.control_dt_s,
            skills=self.spec.skills,
            max_episode_steps=self.spec.max_episode_steps,
            snapshots=self.spec.exact_snapshots,
        )


def check_action(spec: ActionSpec, action: npt.NDArray[Any]) -> None:
    """Checks one action.

    Raises:
        InvalidInput: Its dtype, shape or values are not what the spec says.
    """
    dtype = np.int64 if spec.choices else np.float32
    if not isinstance(action, np.ndarray) or action.dtype != dtype or action.shape != (spec.size,):
        got = f"{action.dtype} {action.shape}" if isinstance(action, np.ndarray) else type(action).__name__
        raise InvalidInput(f"Expected an action of {np.dtype(dtype)} ({spec.size},); got {got}.", field="action")
    low, high = (0, spec.choices - 1) if spec.choices else (-1, 1)
    if not np.all((action >= low) & (action <= high)):  # false for NaN
        raise InvalidInput(
            f"Every number of an action must be finite and in [{low}, {high}]; got one that is not.",
            field="action",
            hint="Clip what the policy proposes before stepping.",
        )


def check_view(spec: WorldSpec, camera: str, *, height: int, width: int) -> Camera:
    """Returns the camera of that name, when it can render that size.

    Raises:
        InvalidInput: There is no such camera, or the size is out of bounds.
    """
    found = next((each for each in spec.cameras if each.name == camera), None)
    if found is None:
        names = ", ".join(each.name for each in spec.cameras)
        raise InvalidInput(f"Expected one of the cameras {names}; got another name.", field="camera")
    if not (1 <= height <= spec.max_size and 1 <= width <= spec.max_size):
        raise InvalidInput(
            f"Frames are 1 to {spec.max_size} pixels high and wide; got {height} x {width}.",
            field="height" if not 1 <= height <= spec.max_size else "width",
        )
    return found


def skill_indices(spec: WorldSpec, skills: Sequence[str]) -> tuple[int, ...]:
    """Returns the skills as indices into the spec's.

    Raises:
        InvalidInput: The world does not have one of them.
    """
    missing = sum(skill not in spec.skills for skill in skills)
    if missing:
        raise InvalidInput(
            f"Expected skills among {', '.join(spec.skills)}; {missing} of {len(skills)} are others.", field="skills"
        )
    return tuple(spec.skills.index(skill) for skill in skills)
