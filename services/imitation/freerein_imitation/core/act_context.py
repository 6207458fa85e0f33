"""`ActContext`: the policy and the goals that the observations of a call, a stream or a WebSocket share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.types.common import Goal, ModelRef, Observation
from freerein.types.imitation import GetSpecResponse, Resize
from freerein_imitation.core.inference import InferenceRequest
from freerein_imitation.core.inputs import (
    Subgoal,
    goal_digest,
    parse_frames,
    parse_goal,
    parse_previous_action,
    parse_robot_state,
)
from freerein_imitation.core.policy_state import PolicyState, decode_state, encode_state
from freerein_imitation.core.resizing import Resizer
from freerein_imitation.model.policy import Policy, PolicySpec


@dataclass(frozen=True, eq=False)
class ActContext:
    """The policy and the goals.

    Attributes:
        model: Name and version of the model.
        policy: The policy.
        goals: Goals in the order in which to reach them.
        digest: Digest of the goals.
        max_steps: Control steps after which each goal is abandoned.
        resizer: Makes images fit; notes whether one of the goals had to be.
    """

    model: ModelRef
    policy: Policy
    goals: tuple[Subgoal, ...]
    digest: bytes
    max_steps: tuple[int, ...]
    resizer: Resizer

    @classmethod
    async def create(
        cls, model: ModelRef, policy: Policy, goal: Goal, *, max_steps: int, resize: Resize | None = None
    ) -> "ActContext":
        """Returns the context of a goal; `max_steps` 0 stands for the model's own limits.

        Raises:
            InvalidInput: The goal does not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        resizer = Resizer(resize)
        goals = await parse_goal(policy.spec, goal, resizer)
        limits = tuple(max_steps or policy.spec.step_limit(each.content) for each in goals)
        return cls(model, policy, goals, goal_digest(goals), limits, resizer)

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
        self,
        observation: Observation,
        executed: npt.NDArray[Any] | None,
        state: PolicyState,
        *,
        elapsed: int,
        resizer: Resizer | None = None,
    ) -> InferenceRequest:
        """Returns an observation as an inference request.

        Args:
            observation: The observation.
            executed: Actions executed since the previous observation, (N, A), or None.
            state: Policy state before the observation.
            elapsed: Control steps since the observation of that state.
            resizer: Makes the observation's images fit; None for images that must.

        Raises:
            InvalidInput: Observation or actions do not match the policy.
            UnsupportedMedia: An image is not in the encoding that it names.
        """
        spec = self.policy.spec
        return InferenceRequest(
            policy=self.policy,
            version=self.model.version,
            goals=self.goals,
            frames=await parse_frames(spec, observation, resizer or Resizer(None)),
            previous=parse_previous_action(spec, executed),
            state=state,
            elapsed=elapsed,
            max_steps=self.max_steps[min(state.goal_index, len(self.goals) - 1)],
            robot_state=parse_robot_state(spec, observation),
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
        goal_texts=spec.goal_texts,
        max_steps_per_goal=spec.max_steps_per_goal,
        reached_threshold=spec.reached_threshold,
        robot_state_size=spec.robot_state_size,
    )
