"""`PolicySession`: a policy's state over the observations of one robot, for unary calls, streams and WebSockets."""

import time
from typing import Any

import numpy.typing as npt

from freerein.serving.batcher import Batcher, BatchResult
from freerein.types.common import Observation, Timing
from freerein_imitation.core.act_context import ActContext
from freerein_imitation.core.inference import InferenceRequest, InferenceResult
from freerein_imitation.core.resizing import Resizer

PolicyBatcher = Batcher[InferenceRequest, InferenceResult]


class PolicySession:
    """Judges and answers observations one after the other.

    Args:
        context: The policy and the goals.
        batcher: Runs `PolicyRunner.run_batch` on the model's thread.
        state: An API `state` to continue from; empty to start.
        timeout_s: Longest wait of an observation for the model, in seconds.

    Attributes:
        resized: Whether an image of the latest observation or of the goal was resized.

    Raises:
        InvalidInput: The state is malformed.
        FailedPrecondition: The state is of another model or goal.
    """

    def __init__(self, context: ActContext, batcher: PolicyBatcher, *, state: bytes = b"", timeout_s: float) -> None:
        self._context = context
        self._batcher = batcher
        self._timeout_s = timeout_s
        self._state = context.decode_state(state)
        self._has_state = bool(state)
        self.resized = False
        self._elapsed = 0  # control steps since the observation of the state

    @property
    def state(self) -> bytes:
        """The policy state as an API `state`."""
        return self._context.encode_state(self._state)

    async def act(
        self,
        observation: Observation,
        executed: npt.NDArray[Any] | None,
        *,
        elapsed: int,
        arrived_ns: int,
        decode_ns: int = 0,
    ) -> tuple[InferenceResult, Timing]:
        """Returns the actions for an observation, and where the time went.

        After an error the policy state is unchanged, but its control steps count for the goal.

        Args:
            observation: The observation.
            executed: Actions executed since the previous observation, (N, A), or None.
            elapsed: Control steps since the previous observation.
            arrived_ns: Arrival of the observation, on the clock of `time.perf_counter_ns`.
            decode_ns: Nanoseconds of decoding since then, as of its goal.

        Raises:
            InvalidInput: Observation or actions do not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
            ServiceError: The model failed, is overloaded, or did not answer in time.
        """
        start_ns = time.perf_counter_ns()
        self._elapsed += elapsed
        counted = self._elapsed if self._has_state else 0
        resizer = Resizer(self._context.resizer.mode)
        request = await self._context.parse(observation, executed, self._state, elapsed=counted, resizer=resizer)
        self.resized = self._context.resizer.has_resized or resizer.has_resized
        decode_ns += time.perf_counter_ns() - start_ns
        done = await self._batcher.submit(request, key=self._context.model, timeout_s=self._timeout_s)
        self._state, self._has_state, self._elapsed = done.output.state, True, 0
        return done.output, _timing(arrived_ns, decode_ns, done)


def _timing(arrived_ns: int, decode_ns: int, done: BatchResult[InferenceResult]) -> Timing:
    total_ns = time.perf_counter_ns() - arrived_ns
    return Timing(
        queue_ns=total_ns - decode_ns - done.infer_ns,
        decode_ns=decode_ns,
        infer_ns=done.infer_ns,
        total_ns=total_ns,
        batch_size=done.batch_size,
    )
