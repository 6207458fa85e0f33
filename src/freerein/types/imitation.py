"""What the imitation service takes and returns. In the shapes, K is the horizon and A the numbers per action."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera, Draining, Error, Goal, ModelRef, Observation, Timing

GoalForm = Literal["images", "recipe", "text"]


@dataclass(frozen=True)
class GetSpecRequest:
    """Asks for one model's spec.

    Attributes:
        model: Which model.
    """

    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class GetSpecResponse:
    """What a model wants to see and what its actions mean.

    Attributes:
        model: The model that this is about.
        cameras: The cameras that an observation must hold, and the size of their images.
        action: What an action is.
        horizon: Actions per reply, one for each of the next control steps.
        control_dt_s: Time between two actions, in seconds.
        goal_form: The form of its goals.
        skills: The skills that a recipe may name; none where goals are of another form.
        max_steps_per_goal: Control steps after which a goal is given up, unless the request says otherwise.
        reached_threshold: A goal counts as reached when `goal_confidence` is at least this; 1 where the policy cannot
            tell.
    """

    model: ModelRef
    cameras: tuple[Camera, ...]
    action: ActionSpec
    horizon: int
    control_dt_s: float
    goal_form: GoalForm
    skills: tuple[str, ...]
    max_steps_per_goal: int
    reached_threshold: float


@dataclass(frozen=True, eq=False)
class ActRequest:
    """What is seen, what was done, and what is to be achieved.

    Attributes:
        observation: What the robot sees now.
        goal: What is to be achieved: all of it, in every call.
        executed_actions: float32 (N, A) or int64 (N, 1): what was executed since the observation before, whatever was
            proposed; None or N = 0 where nothing was.
        state: What the reply before returned; empty to begin.
        max_steps_per_goal: Control steps after which a goal is given up for the next one; 0 for the model's own number.
        model: Which model.
    """

    observation: Observation
    goal: Goal
    executed_actions: npt.NDArray[Any] | None = None
    state: bytes = b""
    max_steps_per_goal: int = 0
    model: ModelRef = ModelRef()


@dataclass(frozen=True, eq=False)
class ActResponse:
    """What to do next.

    Attributes:
        actions: float32 (K, A) in [-1, 1] or int64 (K, 1); K = 0 when there is nothing more to do: hold.
        goal_confidence: The probability that this observation reaches the goal that was pursued, in [0, 1]; 0 where the
            policy cannot tell.
        goal_index: Goals done with, reached or given up: the index of the one now pursued. It never falls.
        goal_abandoned: Whether a goal was given up, now or before.
        state: The policy's memory, for the next call. Opaque; at most 64 KiB.
        model: The model that answered.
        timing: Where the time went.
        goal_reached: Whether every goal is reached. None where the policy cannot tell: one whose goal is a text has no
            termination head.
    """

    actions: npt.NDArray[Any]
    goal_confidence: float
    goal_index: int
    goal_abandoned: bool
    state: bytes
    model: ModelRef
    timing: Timing
    goal_reached: bool | None = None


@dataclass(frozen=True, eq=False)
class Hello:
    """Who comes, what it will send, and what it takes an action to mean. What differs from the spec is refused.

    Attributes:
        goal: What is to be achieved.
        cameras: The cameras that observations will hold.
        action: What the robot takes an action to mean.
        control_dt_s: Time between two actions of the robot, in seconds.
        model: Which model; the stream keeps the version that it opened with.
        state: The last state that an earlier stream or `Act` returned, to go on from there; empty to begin.
        max_steps_per_goal: As in `ActRequest`.
        valid_for_s: How long after its observation an action may be executed, in seconds; 0 for two control steps
            beyond the chunk.
    """

    goal: Goal
    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    model: ModelRef = ModelRef()
    state: bytes = b""
    max_steps_per_goal: int = 0
    valid_for_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Observed:
    """What the robot sees now, and what it did.

    Attributes:
        seq: Counts up; gaps are fine.
        observation: What the robot sees.
        executed_actions: As in `ActRequest`.
        observation_time_ns: When it was seen, on the robot's clock.
    """

    seq: int
    observation: Observation
    executed_actions: npt.NDArray[Any] | None = None
    observation_time_ns: int = 0


@dataclass(frozen=True, eq=False)
class ControlRequest:
    """One message to a control stream: exactly one of the two. The first is a Hello, and there is no other.

    Attributes:
        hello: Opens the stream.
        observed: An observation.
    """

    hello: Hello | None = None
    observed: Observed | None = None


@dataclass(frozen=True, eq=False)
class Chunk:
    """What to do next; it replaces whatever is left of the chunk before.

    Attributes:
        actions: As in `ActResponse`.
        goal_confidence: As in `ActResponse`.
        goal_index: As in `ActResponse`.
        goal_abandoned: As in `ActResponse`.
        state: As in `ActResponse`.
        observation_time_ns: Echoed.
        valid_until_ns: On the robot's clock: after it the chunk must not be executed, and the robot holds.
        dropped: Observations of this stream so far that a newer one overtook.
        timing: Where the time went.
        goal_reached: As in `ActResponse`.
    """

    actions: npt.NDArray[Any]
    goal_confidence: float
    goal_index: int
    goal_abandoned: bool
    state: bytes
    observation_time_ns: int
    valid_until_ns: int
    dropped: int
    timing: Timing
    goal_reached: bool | None = None


@dataclass(frozen=True, eq=False)
class ControlResponse:
    """One message from a control stream: exactly one of `spec`, `chunk`, `error` and `draining`.

    Attributes:
        seq: The `seq` that a chunk or an error answers.
        spec: Answers the Hello.
        chunk: What to do next.
        error: Why an observation was refused.
        draining: The service has been told to stop: open another stream, elsewhere, with the last state.
    """

    seq: int = 0
    spec: GetSpecResponse | None = None
    chunk: Chunk | None = None
    error: Error | None = None
    draining: Draining | None = None
