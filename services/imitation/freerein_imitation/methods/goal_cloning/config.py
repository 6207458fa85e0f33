"""Configuration of goal cloning."""

from dataclasses import dataclass

from freerein.config import bounded, one_of
from freerein.errors import InvalidInput
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig


@dataclass(frozen=True)
class GoalCloningConfig(DatasetFitConfig):
    """Configuration of a fit of goal-conditioned behavioural cloning.

    Attributes:
        encoder: Image encoder.
        max_goal_steps: Most actions from an observation to its goal.
        close_steps: Frames at most so many actions apart show the same scene.
        far_steps: Frames at least so many actions apart may show a changed one.
        augmentation: Strength of the camera augmentation; 0 for none, as for worlds that are drawn without a camera.
        normalise_exposure: Whether frames are made as bright as the training frames, by the median of their ratios to
            the mean image. For cameras that do not move.
        batch_size: Windows per update; each gives many pairs of observation and goal.
        features: Image features per camera.
        hidden_size: Units of the hidden layers.

    Raises:
        InvalidInput: `close_steps` is not below `far_steps`.
    """

    encoder: str = one_of(ENCODERS, "moments")
    max_goal_steps: int = bounded(5, least=1, most=1000)
    close_steps: int = bounded(12, least=1, most=1000)
    far_steps: int = bounded(20, least=2, most=10_000)
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    normalise_exposure: bool = True
    steps: int = bounded(2500, least=1, most=10_000_000)
    batch_size: int = bounded(8, least=1, most=1024)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    features: int = bounded(160, least=8, most=1024)
    hidden_size: int = bounded(256, least=8, most=1024)
    evaluate_every: int = bounded(100, least=1, most=1_000_000)

    def __post_init__(self) -> None:
        if self.close_steps >= self.far_steps:
            raise InvalidInput(
                f"`close_steps` must be below `far_steps`; got {self.close_steps} and {self.far_steps}.",
                field="config.close_steps",
            )
