"""The `World` protocol: one simulated environment that can be reset, stepped, rendered and snapshotted."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np
import numpy.typing as npt

import freerein.types.sim
from freerein.errors import InvalidInput, Unimplemented, must_be, quoted
from freerein.types.common import ActionSpec, Camera, check_name
from freerein_sim.worlds import camera_effects
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.measures import StateMeasure
from freerein_sim.worlds.predicates import StatePredicate
from freerein_sim.worlds.recipes import RandomOrder, RecipeSampler

Action = npt.NDArray[np.float32] | npt.NDArray[np.int64]
"""float32 (A,) in [-1, 1] for continuous actions, int64 (1,) for discrete ones; (T, A) for T timesteps."""

Frame = npt.NDArray[np.uint8]
"""uint8 (H, W, C), RGB or gray."""

NO_SKILL = -1
"""Label of a timestep without a skill."""

MAX_EPISODE_STEPS = 10_000
"""Most steps of an episode, whatever its world's own number is."""


@dataclass(frozen=True)
class WorldSpec:
    """Static properties of a world.

    Attributes:
        cameras: Cameras with their default frame size; the first is the default camera.
        action: Action spec.
        control_dt_s: Time between two actions, in seconds.
        skills: Skills that the expert can execute; labels are indices into them. Empty for a task without an expert.
        max_episode_steps: Steps after which the caller truncates an episode, if it chooses no other number.
        state_names: Name of each number of the true state.
        has_expert: Whether worlds of this spec have a scripted expert; left out, whether they have skills.
        max_size: Greatest frame height and width, in pixels.
        max_skills: Most skills of a recipe under the world's conditions; 0 for no other limit than the task's.
    """

    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    skills: tuple[str, ...]
    max_episode_steps: int
    state_names: tuple[str, ...]
    has_expert: bool = cast(bool, None)
    max_size: int = 320
    max_skills: int = field(default=0, repr=False)  # fingerprints of worlds hash the repr

    def __post_init__(self) -> None:
        if self.has_expert is None:
            object.__setattr__(self, "has_expert", bool(self.skills))


@dataclass(frozen=True)
class StepResult:
    """Whether the episode terminated, and because the simulation diverged; truncation is up to the caller."""

    terminated: bool
    diverged: bool = False


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """True state and oracle reward, for evaluation only.

    Attributes:
        state: float64 (S,), named by the spec's `state_names`.
        reward: Oracle reward of this state.
        success: Whether the task's goal holds.
    """

    state: npt.NDArray[np.float64]
    reward: float
    success: bool


@dataclass(frozen=True, eq=False)
class LabelledAction:
    """Action of one timestep and the index of the skill that it belongs to, or `NO_SKILL`."""

    action: Action
    skill: int


class ScriptedPolicy(Protocol):
    """A scripted policy. It may read the world's true state."""

    def act(self) -> LabelledAction | None:
        """Returns the next action, None when the policy has finished."""

    def succeeded(self) -> bool:
        """Returns whether all skills were executed successfully."""


class MakeExpert(Protocol):
    """A world's method that makes scripted experts."""

    def __call__(self, skills: Sequence[str], rng: np.random.Generator) -> ScriptedPolicy:
        """Returns an expert that executes the skills in order, starting from the current state.

        Args:
            skills: Empty means the recipe of the episode: the one that its reset was given or drew. In a world whose
                episodes have none, one that it draws, or all of the spec's.
            rng: Draws what the expert chooses freely.

        Raises:
            InvalidInput: Unknown skill.
        """


class MakeExplorer(Protocol):
    """Makes what acts in self-supervised exploration."""

    def __call__(self, world: "UnsavedWorld", rng: np.random.Generator, /) -> ScriptedPolicy:
        """Returns a policy that chooses actions by `rng`, and by what a robot's own sensors tell of the world.

        Its `act` returns None where a manoeuvre begins that is no action of the robot, such as backing up after a
        crash: the trajectory ends there. Its first call returns an action.
        """


class UnsavedWorld(Protocol):
    """One environment that may be unable to save its state; `worlds.replay` makes it a `World`.

    Not thread-safe; `render` and `close` must be called from the same thread.
    """

    @property
    def spec(self) -> WorldSpec:
        """Static properties."""

    @property
    def fingerprint(self) -> str:
        """Hash of everything that snapshots depend on; a snapshot restores only where it is equal."""

    def reset(self, rng: np.random.Generator, *, recipe: Sequence[str] = ()) -> None:
        """Begins an episode.

        Args:
            rng: Draws the initial state.
            recipe: Skills that the episode will execute, in order; empty for a recipe that the world draws, if its
                episodes have any.

        Raises:
            InvalidInput: The recipe names an unknown skill, or is none of this world's.
        """

    def step(self, action: Action) -> StepResult:
        """Simulates one control step.

        Raises:
            InvalidInput: The action does not match the spec.
        """

    def render(self, camera: str, *, height: int, width: int) -> Frame:
        """Returns the camera's current image, as a new array.

        Raises:
            InvalidInput: Unknown camera, or size out of bounds.
            Unimplemented: This machine cannot render.
        """

    def truth(self) -> GroundTruth:
        """Returns true state and oracle reward."""

    @property
    def expert(self) -> "MakeExpert | None":
        """Makes scripted experts; None in a world without."""

    def close(self) -> None:
        """Frees resources; may be called twice."""


class World(UnsavedWorld, Protocol):
    """One environment that saves and restores its state."""

    @property
    def steps(self) -> int | None:
        """Steps since the reset; None in a world whose snapshots do not record them."""

    def snapshot(self) -> bytes:
        """Returns the complete state; after `restore` the same actions give the same bits."""

    def restore(self, snapshot: bytes) -> None:
        """Restores a snapshot from a world of the same fingerprint.

        Raises:
            InvalidInput: The bytes are not a snapshot of this world; the state is unchanged.
        """


@dataclass(frozen=True)
class TaskDefinition:
    """A world with an optional goal, as registered under the entry point `freerein.worlds`.

    Attributes:
        name: Task name, `^[a-z0-9][a-z0-9._-]{0,63}$`.
        world: World name.
        goal_text: Goal in words; empty for a task without a goal.
        spec: The world's spec, available without building it.
        make: Builds a world; it must be reset before use. Takes `conditions` where it has `own_conditions`.
        predicates: What can be checked on true states.
        own_conditions: Conditions that its world implements.
        recipes: Draws what episodes execute.
        version: Version of the world, the same for all of its tasks; raised where it behaves differently. Results name
            it: those of another version are measured again.
        explorer: Makes what explores; None for `random_policy.SmoothRandomPolicy`.
        measures: What can be measured on true states.
        reward_free: Whether every reward is 0: the task has no goal of its own.
    """

    name: str
    world: str
    goal_text: str
    spec: WorldSpec
    make: Callable[..., World]
    predicates: tuple[StatePredicate, ...] = ()
    own_conditions: tuple[Condition, ...] = ()
    recipes: RecipeSampler = field(default_factory=RandomOrder)
    version: int = 1
    explorer: MakeExplorer | None = None
    measures: tuple[StateMeasure, ...] = ()
    reward_free: bool = False

    def __post_init__(self) -> None:
        check_name(self.name, field="task")
        check_name(self.world, field="world")

    @property
    def world_version(self) -> str:
        """Name and version of the world, such as `blocks-v1`."""
        return f"{self.world}-v{self.version}"

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """All conditions: camera effects, if its cameras see RGB, and those of its world."""
        sees_rgb = all(camera.channels == 3 for camera in self.spec.cameras)
        return (camera_effects.CONDITIONS if sees_rgb else ()) + self.own_conditions

    def describe(self) -> freerein.types.sim.Task:
        """Returns the task as the API describes it."""
        fewest, most = self.recipes.lengths(self.spec.skills)
        return freerein.types.sim.Task(
            name=self.name,
            world=self.world,
            goal_text=self.goal_text,
            cameras=self.spec.cameras,
            action=self.spec.action,
            control_dt_s=self.spec.control_dt_s,
            skills=self.spec.skills,
            max_episode_steps=self.spec.max_episode_steps,
            predicates=tuple(predicate.describe() for predicate in self.predicates),
            has_expert=self.spec.has_expert,
            conditions=tuple(condition.name for condition in self.conditions),
            min_skills=fewest,
            max_skills=most,
            has_explorer=self.explorer is not None,
            measures=tuple(measure.describe() for measure in self.measures),
            reward_free=self.reward_free,
        )


def check_actions(spec: ActionSpec, actions: npt.NDArray[Any], *, batch: tuple[int, ...] = ()) -> None:
    """Raises InvalidInput where one action, or a batch of shape (*batch, A), does not match the spec."""
    (low, high), shape = spec.bounds, (*batch, spec.size)
    if not isinstance(actions, np.ndarray) or actions.dtype != spec.dtype or actions.shape != shape:
        got = f"{actions.dtype} {actions.shape}" if isinstance(actions, np.ndarray) else type(actions).__name__
    elif wrong := int((~((actions >= low) & (actions <= high))).sum()):  # NaN is neither
        got = f"{wrong} of {actions.size} numbers outside"
    else:
        return
    rule = f"{spec.dtype} {shape}, finite and within [{low:g}, {high:g}]: {', '.join(spec.names)}"
    raise must_be("actions", rule, got, hint="See the task's `action` in ListTasks.")


def check_view(spec: WorldSpec, camera: str, *, height: int, width: int) -> None:
    """Raises InvalidInput where the camera is unknown, or the size out of bounds."""
    names = [each.name for each in spec.cameras]
    if camera not in names:
        raise InvalidInput(f"Expected one of the cameras {', '.join(names)}; got {quoted(camera)}.", field="camera")
    if not (1 <= height <= spec.max_size and 1 <= width <= spec.max_size):
        raise InvalidInput(
            f"Frames are 1 to {spec.max_size} pixels high and wide; got {height} x {width}.",
            field="height" if not 1 <= height <= spec.max_size else "width",
        )


def sized_cameras(spec: WorldSpec, names: Iterable[str], *, height: int, width: int) -> tuple[Camera, ...]:
    """Returns the named cameras, each once, with the frame size to render; 0 means the camera's own.

    Raises InvalidInput as `check_view`.
    """
    sized = []
    for name in dict.fromkeys(names):
        own = next((camera for camera in spec.cameras if camera.name == name), spec.cameras[0])
        camera = Camera(name, height or own.height, width or own.width, own.channels)
        check_view(spec, name, height=camera.height, width=camera.width)
        sized.append(camera)
    return tuple(sized)


def expert_of(world: UnsavedWorld) -> MakeExpert:
    """Returns what makes the world's experts. Raises Unimplemented in a world without."""
    if world.expert is None or not world.spec.has_expert:
        raise no_expert()
    return world.expert


def check_saves(world: UnsavedWorld) -> None:
    """Raises Unimplemented for a world that cannot save its state."""
    if not hasattr(world, "snapshot"):
        raise Unimplemented(
            "The task's world must save its state; this one cannot.",
            hint="Its package must make `ReplayedWorld(world)`, which repeats the actions instead.",
        )


def foreign_snapshot(expected: str = "a snapshot of this world", got: str = "something else") -> InvalidInput:
    """Returns the error for a snapshot that is not what was expected."""
    return InvalidInput(f"Expected {expected}; got {got}.", field="snapshot", hint="Send it back unchanged.")


def no_expert() -> Unimplemented:
    """Returns the error for a task without an expert."""
    return Unimplemented(
        "The task must have a scripted expert; this one has none.",
        hint="Choose a task whose `has_expert` is true in ListTasks.",
    )


def skill_indices(spec: WorldSpec, skills: Sequence[str], *, field: str = "skills") -> tuple[int, ...]:
    """Returns the indices of skills in the spec. Raises InvalidInput where one is unknown."""
    missing = sum(skill not in spec.skills for skill in skills)
    if missing:
        raise InvalidInput(
            f"Expected skills among {', '.join(spec.skills)}; {missing} of {len(skills)} are others.",
            field=field,
            hint="See the task's `skills` in ListTasks.",
        )
    return tuple(spec.skills.index(skill) for skill in skills)
