"""What a fit of a goal-conditioned policy may choose."""

from dataclasses import dataclass
from typing import Literal

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig


@dataclass(frozen=True)
class GoalConditionedConfig(FitConfig):
    """Everything that a fit of a goal-conditioned policy may choose.

    Attributes:
        policy: Which kind of policy this is.
        camera: Whose frames to learn from; empty where the dataset has one camera.
        forward_consistency: lambda of eq. 3.4; 0 for no forward model.
        use_previous_action: Whether the policy sees the action executed last, as in the dissertation.
        shortest_slice: Fewest actions from a slice's first frame to its goal.
        longest_slice: Most.
        close_steps: A frame at most so many actions from a goal is close to it.
        far_steps: A frame more actions than that from a goal is not close to it.
        batch_size: Windows per update; each is cut into many slices.
        features: Image features of the policy.
        hidden: Units of its LSTM.
        embedding: Dimensions of the recognizer's embedding.
        validation_fraction: Fraction of trajectories held out to choose weights and the reached threshold.

    Raises:
        InvalidInput: The shortest slice is longer than the longest, or close frames may be far.
    """

    policy: Literal["goal_conditioned"] = "goal_conditioned"
    camera: str = ""
    forward_consistency: float = bounded(0.0, least=0.0, most=100.0)
    use_previous_action: bool = True
    shortest_slice: int = bounded(5, least=1, most=1000)
    longest_slice: int = bounded(15, least=1, most=1000)
    close_steps: int = bounded(2, least=1, most=1000)
    far_steps: int = bounded(15, least=1, most=10_000)
    steps: int = bounded(300, least=1, most=10_000_000)
    batch_size: int = bounded(24, least=1, most=1024)
    lr: float = bounded(6e-3, least=1e-7, most=1.0)
    features: int = bounded(128, least=8, most=1024)
    hidden: int = bounded(128, least=8, most=1024)
    embedding: int = bounded(64, least=2, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)

    def __post_init__(self) -> None:
        for less, more in (("shortest_slice", "longest_slice"), ("close_steps", "far_steps")):
            if getattr(self, less) > getattr(self, more):
                raise InvalidInput(
                    f"`{less}` must not be above `{more}`; got {getattr(self, less)} and {getattr(self, more)}.",
                    field=f"config.{less}",
                )

    @property
    def bounds(self) -> tuple[int, int]:
        """Fewest and most actions in a slice."""
        return self.shortest_slice, self.longest_slice
