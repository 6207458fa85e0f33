"""Batched policy inference.

Each observation is tested against its current goal once. Where the goal is reached, or its time is up, the recurrent
state is reset, but for what a policy remembers of the robot, and a second forward pass computes the actions for the
next goal.
"""

import hashlib
import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from freerein.errors import OutputNotFinite, ServiceError
from freerein.types.imitation import Done, DoneBy
from freerein_imitation.core.inputs import Subgoal, goal_digest
from freerein_imitation.core.policy_state import PolicyState, encode_state
from freerein_imitation.model.policy import CameraFrames, Policy, PolicyOutput

_CACHE_BYTES = 32 * 2**20
_ENTRY_BYTES = 500  # upper bound of Python's overhead per entry of the cache


@dataclass(frozen=True, eq=False)
class InferenceRequest:
    """One observation, with everything needed to compute its actions.

    Attributes:
        policy: The policy.
        version: Version of the model.
        goals: Sequence of goals, at least one.
        frames: By camera, uint8 (H, W, C).
        previous: Last executed action, float32 (A,) or int64 (1,).
        state: Policy state before the observation.
        elapsed: Control steps since the observation of that state.
        max_steps: Control steps after which the current goal is abandoned.
        robot_state: The robot's own state, float32 (S,); None for a policy that takes none.
    """

    policy: Policy
    version: str
    goals: tuple[Subgoal, ...]
    frames: CameraFrames
    previous: npt.NDArray[Any]
    state: PolicyState
    elapsed: int
    max_steps: int
    robot_state: npt.NDArray[np.float32] | None = None

    @property
    def goal(self) -> Subgoal:
        """The current goal; the last one when all are over."""
        return self.goals[min(self.state.goal_index, len(self.goals) - 1)]


@dataclass(frozen=True, eq=False)
class InferenceResult:
    """Actions for one observation.

    Attributes:
        actions: float32 (K, A) or int64 (K, 1); K = 0 when all goals are over.
        reached: Whether all goals were reached; None where the policy does not predict it.
        confidence: Probability that the observation reaches the goal that was current.
        in_distribution: How much the observation, with that goal, is like held-out ones, in [0, 1].
        state: Policy state after the observation.
    """

    actions: npt.NDArray[Any]
    reached: bool | None
    confidence: float
    in_distribution: float
    state: PolicyState

    @property
    def done(self) -> Done:
        """Whether all goals are over."""
        if not len(self.actions):
            return "yes"
        return "unknown" if self.reached is None else "no"

    @property
    def done_by(self) -> DoneBy | None:
        """Who says that all goals are over; None while they are not."""
        if len(self.actions):
            return None
        return "step_limit" if self.state.abandoned else "policy"


class _Row(NamedTuple):
    """A policy's output for one request: actions (K, A), probability, recurrent state (R,), in-distribution score.

    `settled` tells whether the probability has lasted for long enough to count.
    """

    actions: npt.NDArray[Any]
    reached: float
    recurrent: npt.NDArray[np.float32]
    in_distribution: float
    settled: bool


class PolicyRunner:
    """Runs policies on batches, with an LRU cache of goal embeddings, since unary calls repeat their goal images.

    Args:
        cache_bytes: Size of the cache.
    """

    def __init__(self, *, cache_bytes: int = _CACHE_BYTES) -> None:
        self._goal_cache: OrderedDict[tuple[str, bytes], npt.NDArray[np.float32]] = OrderedDict()
        self._max_cache_bytes = cache_bytes
        self._cached_bytes = 0

    def run_batch(self, requests: Sequence[InferenceRequest]) -> list[InferenceResult | ServiceError]:
        """Returns a result or an error for each request, all of one policy."""
        first = self._forward(requests)
        states = [_advance(request, row) for request, row in zip(requests, first, strict=True)]
        last = list(first)
        if continuing := [i for i, request in enumerate(requests) if _starts_next_goal(request, states[i])]:
            rows = self._forward([replace(requests[i], state=states[i]) for i in continuing])
            for i, row in zip(continuing, rows, strict=True):
                last[i] = row
        return [_result(*each) for each in zip(requests, first, last, states, strict=True)]

    def _forward(self, requests: Sequence[InferenceRequest]) -> list[_Row | OutputNotFinite]:
        """Returns the policy's output for each request's observation and current goal."""
        policy = requests[0].policy
        robot_states = [request.robot_state for request in requests if request.robot_state is not None]
        sampling = {"draws": _stack([_draws(request) for request in requests])} if policy.spec.draws else {}
        output = policy.step(
            _stack_frames([request.frames for request in requests]),
            self._encode_goals(requests),
            _stack([request.previous for request in requests]),
            _recurrent_states(requests),
            _stack(robot_states) if robot_states else None,
            **sampling,
        )
        _check_shapes(policy, output, len(requests))
        finite = _finite(output)
        return [
            _Row(
                output.actions[i],
                float(output.reached[i]),
                output.recurrent[i],
                float(output.in_distribution[i]),
                output.settled is None or bool(output.settled[i]),
            )
            if finite[i]
            else _not_finite()
            for i in range(len(requests))
        ]

    def _encode_goals(self, requests: Sequence[InferenceRequest]) -> npt.NDArray[np.float32]:
        """Returns the embeddings of the requests' current goals, (B, G): each goal's alone, whatever else is asked."""
        keys = [(request.version, request.goal.digest) for request in requests]
        contents = {key: request.goal.content for key, request in zip(keys, requests, strict=True)}
        for key in [key for key in contents if key not in self._goal_cache]:
            goal: Any = contents[key]
            (embedding,) = requests[0].policy.encode_goals([goal] if isinstance(goal, str) else _stack_frames([goal]))
            self._goal_cache[key] = embedding.copy()
            self._cached_bytes += embedding.nbytes + _ENTRY_BYTES
        for key in keys:
            self._goal_cache.move_to_end(key)
        found = [self._goal_cache[key] for key in keys]
        while self._cached_bytes > self._max_cache_bytes:
            self._cached_bytes -= self._goal_cache.popitem(last=False)[1].nbytes + _ENTRY_BYTES
        return _stack(found)


def _recurrent_states(requests: Sequence[InferenceRequest]) -> npt.NDArray[np.float32]:
    """Returns the recurrent states just before the requests' observations, (B, R)."""
    policy, recurrent = requests[0].policy, _stack([request.state.recurrent for request in requests])
    unobserved = np.array([max(request.elapsed - 1, 0) for request in requests], np.int64)
    return policy.skip_steps(recurrent, unobserved) if unobserved.any() else recurrent


def _draws(request: InferenceRequest) -> npt.NDArray[np.float64]:
    """Returns uniform numbers in [0, 1) that a hash of the policy's state and the observation gives, float64 (U,).

    Equal calls have equal actions. The frames are hashed, too: the state of a policy without recurrence counts steps
    alone, so that all robots with one goal would draw alike.
    """
    spec, goal = request.policy.spec, goal_digest(request.goals)
    state = encode_state(request.state, version=request.version, goal_digest=goal, pixels=spec.recurrent_pixels)
    digest = hashlib.shake_256(state)
    for camera in spec.cameras:
        digest.update(request.frames[camera.name].tobytes())
    words = np.frombuffer(digest.digest(8 * spec.draws), "<u8")
    return (words >> np.uint64(11)).astype(np.float64) * 2.0**-53


def _stack(arrays: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
    """Returns arrays along a new first axis; a single one is not copied."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)


def _stack_frames(frames: Sequence[CameraFrames]) -> CameraFrames:
    return {camera: _stack([each[camera] for each in frames]) for camera in frames[0]}


def _check_shapes(policy: Policy, output: PolicyOutput, batch: int) -> None:
    spec = policy.spec
    expected = ((batch, spec.horizon, spec.action.size), (batch,), (batch, spec.recurrent_size), (batch,))
    got = tuple(array.shape for array in _arrays(output))
    if got != expected:
        raise ValueError(f"the policy's output must have shapes {expected}; got {got}")


def _finite(output: PolicyOutput) -> Sequence[bool]:
    """Tells for each request whether the policy's output is finite."""
    arrays = _arrays(output)
    if math.isfinite(sum(np.vdot(array, array) for array in arrays)):
        return [True] * len(output.reached)  # a sum of squares takes a third of the time of testing each number
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for array in arrays]
    return [bool(each) for each in np.logical_and.reduce(finite)]


def _arrays(output: PolicyOutput) -> tuple[npt.NDArray[Any], ...]:
    return output.actions, output.reached, output.recurrent, output.in_distribution


def _not_finite() -> OutputNotFinite:
    return OutputNotFinite(
        "The policy's output must be finite; got NaN or infinity for this observation.",
        field="observation",
        hint="Start anew without a state; if it happens again, report it.",
    )


def _advance(request: InferenceRequest, row: _Row | OutputNotFinite) -> PolicyState:
    """Returns the policy state after an observation was tested.

    A new goal starts with the recurrent state before the observation, without what was of the last one.
    """
    state = request.state
    if isinstance(row, OutputNotFinite):
        return state
    if state.goal_index == len(request.goals):
        return replace(state, recurrent=row.recurrent)
    steps = state.goal_steps + request.elapsed
    reached = row.settled and row.reached >= request.policy.spec.reached_threshold
    if reached or steps >= request.max_steps:
        abandoned = state.abandoned or not reached
        recurrent = request.policy.reset_goal_state(state.recurrent[None])[0]
        return PolicyState(recurrent, state.goal_index + 1, 0, abandoned)
    return PolicyState(row.recurrent, state.goal_index, steps, state.abandoned)


def _starts_next_goal(request: InferenceRequest, state: PolicyState) -> bool:
    return request.state.goal_index < state.goal_index < len(request.goals)


def _result(
    request: InferenceRequest, first: _Row | OutputNotFinite, last: _Row | OutputNotFinite, state: PolicyState
) -> InferenceResult | ServiceError:
    if isinstance(first, OutputNotFinite) or isinstance(last, OutputNotFinite):
        return _not_finite()
    is_over = state.goal_index == len(request.goals)
    reached = is_over and not state.abandoned if request.policy.spec.predicts_reached else None
    if is_over:
        return InferenceResult(last.actions[:0], reached, first.reached, first.in_distribution, state)
    if last is not first:
        state = replace(state, recurrent=last.recurrent)
    return InferenceResult(last.actions, reached, first.reached, first.in_distribution, state)
