"""`PolicySession`: a policy's state over the observations of one robot, for unary calls, streams and WebSockets."""

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.serving.batcher import Batcher, BatchResult
from freerein.types.common import Observation, Timing
from freerein_imitation.core.act_context import ActContext
from freerein_imitation.core.inference import InferenceRequest, InferenceResult
from freerein_imitation.core.inputs import parse_frames, parse_previous_action, parse_robot_state
from freerein_imitation.core.policy_state import PolicyState, decode_state, encode_state
from freerein_imitation.core.resizing import Resizer

PolicyBatcher = Batcher[InferenceRequest, InferenceResult]


class PolicySession:
    """Judges observations one after the other: `parse`, the model, `answer`.

    Args:
        context: The policy and the goals.
        state: An API `state` to continue from; empty to start.

    Raises:
        InvalidInput: The state is malformed.
        FailedPrecondition: The state is of another model or goal.
    """

    def __init__(self, context: ActContext, *, state: bytes = b"") -> None:
        self._context = context
        version, spec = context.model.version, context.policy.spec
        self._state = (
            decode_state(
                state,
                version=version,
                goal_digest=context.digest,
                goals=len(context.goals),
                size=spec.recurrent_size,
                pixels=spec.recurrent_pixels,
            )
            if state
            else PolicyState(np.zeros(spec.recurrent_size, np.float32))
        )
        self._has_state = bool(state)
        self._resized = False
        self._elapsed = 0  # control steps since the observation of the state

    @property
    def state(self) -> bytes:
        """The policy state as an API `state`."""
        context, pixels = self._context, self._context.policy.spec.recurrent_pixels
        return encode_state(self._state, version=context.model.version, goal_digest=context.digest, pixels=pixels)

    async def parse(
        self, observation: Observation, executed: npt.NDArray[Any] | None, *, elapsed: int
    ) -> InferenceRequest:
        """Returns an observation for the model.

        Where that fails, or the model does, the policy state stays, but the control steps count for the goal.

        Args:
            observation: The observation.
            executed: Actions executed since the previous observation, (N, A), or None.
            elapsed: Control steps since the previous observation.

        Raises:
            InvalidInput: Observation or actions do not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        self._elapsed += elapsed
        context, state, spec = self._context, self._state, self._context.policy.spec
        resizer = Resizer(context.resizer.mode)
        request = InferenceRequest(
            policy=context.policy,
            version=context.model.version,
            goals=context.goals,
            frames=await parse_frames(spec, observation, resizer),
            previous=parse_previous_action(spec, executed),
            state=state,
            elapsed=self._elapsed if self._has_state else 0,
            max_steps=context.max_steps[min(state.goal_index, len(context.goals) - 1)],
            robot_state=parse_robot_state(spec, observation),
        )
        self._resized = context.resizer.has_resized or resizer.has_resized
        return request

    def answer(
        self, done: BatchResult[InferenceResult], *, arrived_ns: int, decoding_ns: int | None = None
    ) -> dict[str, Any]:
        """Returns the common part of replies over all protocols, and keeps the state for the next observation.

        Args:
            done: The model's answer to the observation.
            arrived_ns: Arrival of the observation, on the clock of `time.perf_counter_ns`.
            decoding_ns: When its decoding began; None for at once.
        """
        result = done.output
        self._state, self._has_state, self._elapsed = result.state, True, 0
        total_ns = time.perf_counter_ns() - arrived_ns
        decode_ns = done.submitted_ns - (decoding_ns or arrived_ns)
        return {
            "actions": result.actions,
            "done": result.done,
            "done_by": result.done_by,
            "goal_reached": result.reached,
            "goal_confidence": result.confidence,
            "goal_index": result.state.goal_index,
            "goal_abandoned": result.state.abandoned,
            "in_distribution": result.in_distribution,
            "timing": Timing(
                queue_ns=total_ns - decode_ns - done.infer_ns,
                decode_ns=decode_ns,
                infer_ns=done.infer_ns,
                total_ns=total_ns,
                batch_size=done.batch_size,
            ),
            "resized": self._resized,
        }
