"""`ActService`: an observation and a goal in, actions and a goal-reached flag out. It is stateless between calls."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.serving.batcher import Batcher, BatchResult
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Goal, ModelRef, Observation, Timing
from freerein.types.imitation import ActRequest, ActResponse, GetSpecRequest, GetSpecResponse
from freerein_imitation.core.inference import InferenceRequest, InferenceResult
from freerein_imitation.core.inputs import (
    Subgoal,
    elapsed_steps,
    goal_digest,
    parse_frames,
    parse_goal,
    parse_previous_action,
)
from freerein_imitation.core.policy_state import PolicyState, decode_state, encode_state
from freerein_imitation.model.policy import Policy, PolicySpec

Policies = ModelCache[Policy]
PolicyBatcher = Batcher[InferenceRequest, InferenceResult]


class ActService:
    """Answers `GetSpec` and `Act`.

    Args:
        models: The policies.
        batcher: Runs `PolicyRunner.run_batch` on the model's thread.
        timeout_s: Longest wait of an observation for the model, in seconds.
    """

    def __init__(self, models: Policies, batcher: PolicyBatcher, *, timeout_s: float) -> None:
        self._models = models
        self._batcher = batcher
        self._timeout_s = timeout_s

    async def get_spec(self, request: GetSpecRequest) -> GetSpecResponse:
        """Returns a model's spec.

        Raises:
            NotFound: There is no such model.
            FailedPrecondition: No model is active.
        """
        model, policy = await self._models.resolve(request.model)
        return spec_response(model, policy.spec)

    async def act(self, request: ActRequest) -> ActResponse:
        """Returns the next actions, and whether the goal is reached.

        Raises:
            InvalidInput: Observation, goal, executed actions or state do not match the model.
            NotFound: There is no such model.
            FailedPrecondition: No model is active, or the state is of another model or goal.
        """
        start_ns = time.perf_counter_ns()
        model, policy = await self._models.resolve(request.model)
        context = await ActContext.create(model, policy, request.goal, max_steps=request.max_steps_per_goal)
        state = context.decode_state(request.state)
        elapsed = elapsed_steps(request.executed_actions) if request.state else 0
        item = await context.parse(request.observation, request.executed_actions, state, elapsed=elapsed)
        decode_ns = time.perf_counter_ns() - start_ns
        done = await self._batcher.submit(item, key=model, timeout_s=self._timeout_s)
        result = done.output
        return ActResponse(
            actions=result.actions,
            goal_reached=result.reached,
            goal_confidence=result.confidence,
            goal_index=result.state.goal_index,
            goal_abandoned=result.state.abandoned,
            in_distribution=result.in_distribution,
            state=context.encode_state(result.state),
            model=model,
            timing=timing(start_ns, decode_ns, done),
        )


@dataclass(frozen=True, eq=False)
class ActContext:
    """What the observations of a call or a stream share: the policy and the goals.

    Attributes:
        model: Name and version of the model.
        policy: The policy.
        goals: Goals in the order in which to reach them.
        digest: Digest of the goals.
        max_steps: Control steps after which each goal is abandoned.
    """

    model: ModelRef
    policy: Policy
    goals: tuple[Subgoal, ...]
    digest: bytes
    max_steps: tuple[int, ...]

    @classmethod
    async def create(cls, model: ModelRef, policy: Policy, goal: Goal, *, max_steps: int) -> "ActContext":
        """Returns the context of a goal; `max_steps` 0 stands for the model's own limits.

        Raises:
            InvalidInput: The goal does not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        goals = await parse_goal(policy.spec, goal)
        limits = tuple(max_steps or policy.spec.step_limit(each.content) for each in goals)
        return cls(model, policy, goals, goal_digest(goals), limits)

    def decode_state(self, data: bytes) -> PolicyState:
        """Returns the policy state in an API `state`; the initial one when empty.

        Raises:
            InvalidInput: The state is malformed.
            FailedPrecondition: The state is of another model or goal.
        """
        size = self.policy.spec.recurrent_size
        if not data:
            return PolicyState(np.zeros(size, np.float32))
        version = self.model.version
        return decode_state(data, version=version, goal_digest=self.digest, goals=len(self.goals), size=size)

    def encode_state(self, state: PolicyState) -> bytes:
        """Returns a policy state as an API `state`."""
        return encode_state(state, version=self.model.version, goal_digest=self.digest)

    async def parse(
        self, observation: Observation, executed: npt.NDArray[Any] | None, state: PolicyState, *, elapsed: int
    ) -> InferenceRequest:
        """Returns an observation as an inference request.

        Args:
            observation: The observation.
            executed: Actions executed since the previous observation, (N, A), or None.
            state: Policy state before the observation.
            elapsed: Control steps since the observation of that state.

        Raises:
            InvalidInput: Observation or actions do not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        spec = self.policy.spec
        return InferenceRequest(
            policy=self.policy,
            version=self.model.version,
            goals=self.goals,
            frames=await parse_frames(spec, observation),
            previous=parse_previous_action(spec, executed),
            state=state,
            elapsed=elapsed,
            max_steps=self.max_steps[min(state.goal_index, len(self.goals) - 1)],
        )


def spec_response(model: ModelRef, spec: PolicySpec) -> GetSpecResponse:
    """Returns a policy's spec as the API has it."""
    return GetSpecResponse(
        model=model,
        cameras=spec.cameras,
        action=spec.action,
        horizon=spec.horizon,
        control_dt_s=spec.control_dt_s,
        goal_form=spec.goal_form,
        skills=spec.skills,
        max_steps_per_goal=spec.max_steps_per_goal,
        reached_threshold=spec.reached_threshold,
    )


def timing(start_ns: int, decode_ns: int, done: BatchResult[InferenceResult]) -> Timing:
    """Returns the timing of a reply that is complete now.

    Args:
        start_ns: Arrival of the observation, on the clock of `time.perf_counter_ns`.
        decode_ns: Duration of parsing.
        done: The batcher's result.
    """
    total_ns = time.perf_counter_ns() - start_ns
    return Timing(
        queue_ns=total_ns - decode_ns - done.infer_ns,
        decode_ns=decode_ns,
        infer_ns=done.infer_ns,
        total_ns=total_ns,
        batch_size=done.batch_size,
    )
