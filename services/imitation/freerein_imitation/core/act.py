"""`ActService`: an observation and a goal in, actions and a goal-reached flag out. It is stateless between calls."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from freerein.errors import ServiceError, must_be
from freerein.serving.batcher import BatchResult
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.imitation import (
    ActBatchRequest,
    ActBatchResponse,
    ActRequest,
    ActResponse,
    GetSpecRequest,
    GetSpecResponse,
)
from freerein_imitation.core.act_context import ActContext, spec_response
from freerein_imitation.core.inference import InferenceRequest, InferenceResult
from freerein_imitation.core.inputs import elapsed_steps
from freerein_imitation.core.policy_session import PolicyBatcher, PolicySession
from freerein_imitation.model.policy import Policy

Policies = ModelCache[Policy]


@dataclass(frozen=True, eq=False)
class ActService:
    """Answers `GetSpec`, `Act` and `ActBatch`.

    Attributes:
        models: The policies.
        batcher: Runs `PolicyRunner.run_batch` on the model's thread.
    """

    models: Policies
    batcher: PolicyBatcher

    async def get_spec(self, request: GetSpecRequest) -> GetSpecResponse:
        """Returns a model's spec.

        Raises:
            NotFound: There is no such model.
            FailedPrecondition: No model is active.
        """
        model, policy = await self.models.resolve(request.model)
        return spec_response(model, policy.spec)

    async def act(self, request: ActRequest) -> ActResponse:
        """Returns the next actions, and whether the goal is reached.

        Raises:
            InvalidInput: Observation, goal, executed actions or state do not match the model.
            NotFound: There is no such model.
            FailedPrecondition: No model is active, or the state is of another model or goal.
        """
        begun = await self._begin(request)
        return begun.answer(await self.batcher.submit(begun.parsed, key=begun.model))

    async def act_batch(self, request: ActBatchRequest) -> ActBatchResponse:
        """Returns the next actions for each request, as `act` does, in batches of their own.

        Raises:
            InvalidInput: There are no requests, or some of different models; or as `act` of one of them.
            NotFound: As `act`.
            FailedPrecondition: As `act`.
        """
        if not request.requests:
            raise must_be("requests", "one for each robot", "none", hint="Send at least one.")
        begun = []
        for index, each in enumerate(request.requests):
            with _in_request(index):
                begun.append(await self._begin(each))
        if len({each.model for each in begun}) > 1:
            raise must_be("requests", "of one model", "some of several", hint="Call once for each model.")
        answered = []
        done = await self.batcher.submit_batch([each.parsed for each in begun])
        for index, (asked, result) in enumerate(zip(begun, done, strict=True)):
            with _in_request(index):
                answered.append(asked.answer(result))
        return ActBatchResponse(tuple(answered))

    async def _begin(self, request: ActRequest) -> "_Begun":
        """Returns a request that is ready for the model."""
        start_ns = time.perf_counter_ns()
        model, policy = await self.models.resolve(request.model)
        limit, resize = request.max_steps_per_goal, request.resize
        context = await ActContext.create(model, policy, request.goal, max_steps=limit, resize=resize)
        session = PolicySession(context, state=request.state)
        executed = request.executed_actions
        parsed = await session.parse(request.observation, executed, elapsed=elapsed_steps(executed))
        return _Begun(model, session, parsed, start_ns)


@dataclass(frozen=True, eq=False)
class _Begun:
    """A request that is ready for the model.

    Attributes:
        arrived_ns: On the clock of `time.perf_counter_ns`.
    """

    model: ModelRef
    session: PolicySession
    parsed: InferenceRequest
    arrived_ns: int

    def answer(self, done: BatchResult[InferenceResult] | ServiceError) -> ActResponse:
        """Returns the reply; raises what the model returned in its place."""
        if isinstance(done, ServiceError):
            raise done
        fields = self.session.answer(done, arrived_ns=self.arrived_ns)
        return ActResponse(**fields, state=self.session.state, model=self.model)


@contextmanager
def _in_request(index: int) -> Iterator[None]:
    """Adds the place of a request to the field of its error."""
    try:
        yield
    except ServiceError as error:
        error.field = f"requests.{index}.{error.field}".removesuffix(".")
        raise
