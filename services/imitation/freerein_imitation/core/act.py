"""`ActService`: an observation and a goal in, actions and a goal-reached flag out. It is stateless between calls."""

import time
from dataclasses import dataclass

from freerein.serving.model_cache import ModelCache
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse
from freerein_imitation.core.act_context import ActContext, spec_response
from freerein_imitation.core.inputs import elapsed_steps
from freerein_imitation.core.policy_session import PolicyBatcher, PolicySession
from freerein_imitation.model.policy import Policy

Policies = ModelCache[Policy]


@dataclass(frozen=True, eq=False)
class ActService:
    """Answers `GetSpec` and `Act`.

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
        start_ns = time.perf_counter_ns()
        model, policy = await self.models.resolve(request.model)
        limit, resize = request.max_steps_per_goal, request.resize
        context = await ActContext.create(model, policy, request.goal, max_steps=limit, resize=resize)
        session = PolicySession(context, state=request.state)
        executed = request.executed_actions
        parsed = await session.parse(request.observation, executed, elapsed=elapsed_steps(executed))
        done = await self.batcher.submit(parsed, key=model)
        return ActResponse(**session.answer(done, arrived_ns=start_ns), state=session.state, model=model)
