"""Requests and replies of the imitation service. In shapes, K is the horizon and A the numbers per action."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy.typing as npt

from freerein.types.common import ActionSpec, Camera, Draining, Error, Goal, ModelRef, Observation, Timing

GoalForm = Literal["images", "recipe", "text"]
Resize = Literal["fit", "crop"]
Done = Literal["no", "yes", "unknown"]
DoneBy = Literal["policy", "step_limit"]


@dataclass(frozen=True)
class GetSpecRequest:
    """Requests a model's spec."""

    model: ModelRef = ModelRef()


@dataclass(frozen=True)
class GetSpecResponse:
    """A model's spec.

    Attributes:
        cameras: Cameras of an observation, with image sizes.
        horizon: Actions per reply, one for each of the next control steps.
        control_dt_s: Time between two actions, in seconds.
        goal_form: Form of its goals.
        skills: Skills that a recipe may name; empty for other goal forms.
        goal_texts: The only texts that a goal may be; empty for any, and for other goal forms.
        max_steps_per_goal: Control steps after which a goal is abandoned, unless the request says otherwise.
        reached_threshold: A goal counts as reached from this `goal_confidence` on; 1 where the policy does not predict
            it.
        robot_state_size: Numbers of the robot's own state, `state` of an observation; 0 for a model that takes none.
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
    goal_texts: tuple[str, ...] = ()
    robot_state_size: int = 0


@dataclass(frozen=True, eq=False)
class ActRequest:
    """An observation, the actions executed before it, and the goal.

    Attributes:
        goal: The whole goal, in every call.
        executed_actions: Actions executed since the previous observation, whatever was proposed, float32 (N, A) or
            int64 (N, 1); None or N = 0 for none.
        state: `state` of the previous reply; empty at the start.
        max_steps_per_goal: Control steps after which a goal is abandoned for the next one; 0 for the model's own limit.
        resize: How images of another size than the model's are made to fit, those of the goal, too: `fit`, the whole
            image between black bars; `crop`, its middle; None to refuse them.
    """

    observation: Observation
    goal: Goal
    executed_actions: npt.NDArray[Any] | None = None
    state: bytes = b""
    max_steps_per_goal: int = 0
    model: ModelRef = ModelRef()
    resize: Resize | None = None


@dataclass(frozen=True, eq=False)
class ActResponse:
    """The next actions.

    Attributes:
        actions: float32 (K, A) in [-1, 1] or int64 (K, 1); K = 0 when all goals are over: hold.
        goal_confidence: Probability that this observation reaches the current goal, in [0, 1]; 0 where the policy does
            not predict it.
        goal_index: Number of goals that are over, reached or abandoned: the index of the current one. It never
            decreases.
        goal_abandoned: Whether a goal was abandoned, now or before.
        in_distribution: How much the observation is like held-out ones, in [0, 1]; see
            `freerein.learning.in_distribution`.
        state: The policy state, for the next call. Opaque; at most 64 KiB.
        goal_reached: Whether every goal was reached. None where the policy does not predict it: language policies.
        done: Whether all goals are over, so that K = 0; `unknown` where the policy does not see whether its goal is
            reached; None from a service of an earlier version.
        done_by: Who says so: `policy`, which saw every goal reached, or `step_limit`, after which a goal was abandoned;
            None unless `done` is `yes`.
        resized: Whether an image of the observation or of the goal was resized.
    """

    actions: npt.NDArray[Any]
    goal_confidence: float
    goal_index: int
    goal_abandoned: bool
    in_distribution: float
    state: bytes
    model: ModelRef
    timing: Timing
    goal_reached: bool | None = None
    done: Done | None = None
    done_by: DoneBy | None = None
    resized: bool = False


@dataclass(frozen=True, eq=False)
class ActBatchRequest:
    """Requests of several robots: 1 to 64, all of one model."""

    requests: tuple[ActRequest, ...]


@dataclass(frozen=True, eq=False)
class ActBatchResponse:
    """A reply to each request, in their order."""

    responses: tuple[ActResponse, ...]


@dataclass(frozen=True)
class PublishPolicyRequest:
    """Requests that the policy of a finished ppo run is served by name.

    Attributes:
        run: The run's id.
        model_name: Name of the model; empty for that of the run's task.
    """

    run: str
    model_name: str = ""


@dataclass(frozen=True)
class PublishPolicyResponse:
    """The model, which is active now."""

    model: ModelRef


@dataclass(frozen=True, eq=False)
class Hello:
    """Model and goal of a stream, and the robot's cameras and actions, which must match the model's spec.

    Attributes:
        control_dt_s: Time between two actions of the robot, in seconds.
        model: The model; the stream keeps its version.
        state: Last `state` of an earlier stream or `Act`, to continue from; empty at the start.
        max_steps_per_goal: As in `ActRequest`.
        valid_for_s: Longest age of an observation whose actions may be executed, in seconds; 0 for two control steps
            beyond the chunk.
        resize: As in `ActRequest`; the sizes of `cameras` may then be others than the model's.
    """

    goal: Goal
    cameras: tuple[Camera, ...]
    action: ActionSpec
    control_dt_s: float
    model: ModelRef = ModelRef()
    state: bytes = b""
    max_steps_per_goal: int = 0
    valid_for_s: float = 0.0
    resize: Resize | None = None


@dataclass(frozen=True, eq=False)
class Observed:
    """An observation on a control stream.

    Attributes:
        seq: Sequence number; must increase, gaps are fine.
        executed_actions: As in `ActRequest`.
        observation_time_ns: Time of the observation on the robot's clock.
    """

    seq: int
    observation: Observation
    executed_actions: npt.NDArray[Any] | None = None
    observation_time_ns: int = 0


@dataclass(frozen=True, eq=False)
class ControlRequest:
    """A message to a control stream: either a Hello, which is the first and only one, or an observation."""

    hello: Hello | None = None
    observed: Observed | None = None


@dataclass(frozen=True, eq=False)
class Chunk:
    """The next actions, as in `ActResponse`; they replace what is left of the previous chunk.

    Attributes:
        observation_time_ns: Echoed.
        valid_until_ns: Time on the robot's clock after which the chunk must not be executed; the robot holds.
        dropped: Observations of this stream so far that a newer one replaced.
    """

    actions: npt.NDArray[Any]
    goal_confidence: float
    goal_index: int
    goal_abandoned: bool
    in_distribution: float
    state: bytes
    observation_time_ns: int
    valid_until_ns: int
    dropped: int
    timing: Timing
    goal_reached: bool | None = None
    done: Done | None = None
    done_by: DoneBy | None = None
    resized: bool = False


@dataclass(frozen=True, eq=False)
class ControlResponse:
    """A message from a control stream: exactly one of `spec`, `chunk`, `error` and `draining`.

    Attributes:
        seq: The `seq` that a chunk or an error answers.
        spec: Answer to the Hello.
        error: Why an observation was rejected.
        draining: The service is stopping: open another stream, elsewhere, with the last state.
    """

    seq: int = 0
    spec: GetSpecResponse | None = None
    chunk: Chunk | None = None
    error: Error | None = None
    draining: Draining | None = None
