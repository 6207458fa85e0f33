"""`ActContext`: the policy and the goals that the observations of a call, a stream or a WebSocket share."""

from dataclasses import dataclass

from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import GetSpecResponse, Resize
from freerein_imitation.core.inputs import Subgoal, goal_digest, parse_goal
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
