"""Configuration of the goal-conditioned policy."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein_imitation.methods.shared.goal_images.config import GoalImagesConfig


@dataclass(frozen=True)
class GoalConditionedConfig(GoalImagesConfig):
    """Configuration of a fit of a goal-conditioned policy.

    Attributes:
        forward_consistency_weight: Weight of forward consistency, lambda of eq. 3.4, or of the forward model as a
            regulariser; 0 for no forward model.
        forward_use: What the forward model is for: `consistency` of predicted actions with executed ones, or a
            `regulariser` of the image features, which predict what executed actions lead to.
        forward_target: What it predicts: the next `features`, eq. 3.4, or the next `pixels`, eq. 3.3, of a small image.
        policy_pretraining_steps: First optimiser steps, of the policy alone.
        forward_pretraining_steps: Next optimiser steps, of the forward model alone, whose features are the policy's.
        use_previous_action: Whether the policy takes the previous action as input, as in the dissertation.
        recurrent: Whether the policy has a recurrent layer; without, a goal is abandoned after twice `far_steps`.
        stop: Whether the policy tells by an action of its own that the goal is reached, in place of a goal recognizer.

    Raises:
        InvalidInput: A key of the forward model has no effect, pre-training leaves no step, or a recognizer is named
            beside `stop`.
    """

    forward_consistency_weight: float = bounded(0.0, least=0.0, most=100.0)
    forward_use: Literal["consistency", "regulariser"] = "consistency"
    forward_target: Literal["features", "pixels"] = "features"
    policy_pretraining_steps: int = bounded(0, least=0, most=10_000_000)
    forward_pretraining_steps: int = bounded(0, least=0, most=10_000_000)
    use_previous_action: bool = True
    recurrent: bool = True
    stop: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        keys = ("forward_use", "forward_target", "policy_pretraining_steps", "forward_pretraining_steps")
        given = [key for key in keys if getattr(self, key) != getattr(GoalConditionedConfig, key)]
        if given and not self.forward_consistency_weight:
            raise InvalidInput(
                f"`{given[0]}` is of fits with a forward model; got it with forward_consistency_weight 0.",
                field=f"config.{given[0]}",
                hint="Set forward_consistency_weight, such as to 0.1.",
            )
        pretraining = self.forward_pretraining_steps + self.policy_pretraining_steps
        if pretraining >= self.steps:
            raise InvalidInput(
                f"Steps of pre-training must be fewer than `steps`, which they are part of; got {pretraining} of "
                f"{self.steps}.",
                field="config.steps",
            )
        if self.stop and self.recognizer:
            raise InvalidInput(
                "A policy with `stop` has no goal recognizer to copy; got both.",
                field="config.recognizer",
                hint="Leave out one of them.",
            )
