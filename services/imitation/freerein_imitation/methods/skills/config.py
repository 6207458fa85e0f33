"""Configuration of skills."""

from dataclasses import dataclass

from freerein.config import bounded
from freerein.learning.fit_config import DatasetFitConfig


@dataclass(frozen=True)
class SkillsConfig(DatasetFitConfig):
    """Configuration of a fit of skills.

    Attributes:
        min_segment_steps: Shorter segments are taken for label errors, as in section 2.4.
        termination_steps: Timesteps after a segment's last in which the termination target stays 1.
        termination_weight: Weight of the termination loss relative to the action loss.
        augmentation: Strength of the camera augmentation; 0 for none, as for worlds that are drawn without a camera.
        normalise_exposure: Whether frames are made as bright as the training frames, by the median of their ratios to
            the mean image. For cameras that do not move.
        batch_size: Timesteps per update.
        hidden_size: Units of the hidden layers.
    """

    min_segment_steps: int = bounded(5, least=1, most=1000)
    termination_steps: int = bounded(3, least=0, most=1000)
    termination_weight: float = bounded(0.1, least=0.0, most=100.0)
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    normalise_exposure: bool = True
    steps: int = bounded(12_000, least=1, most=10_000_000)
    batch_size: int = bounded(64, least=1, most=4096)
    hidden_size: int = bounded(192, least=8, most=1024)
    evaluate_every: int = bounded(1000, least=1, most=1_000_000)
    checkpoint_every: int = bounded(2000, least=1, most=1_000_000)
    log_every: int = bounded(50, least=1, most=1_000_000)
