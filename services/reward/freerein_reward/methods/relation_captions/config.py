"""Configuration of `relation_captions`."""

from dataclasses import dataclass
from typing import Literal

from freerein.config import bounded
from freerein.learning.fit_config import DatasetFitConfig


@dataclass(frozen=True)
class RewardConfig(DatasetFitConfig):
    """Configuration of a reward model's fit.

    Attributes:
        phrases: Noun phrases of the goal texts, 2 to 16, which must be given; located in frames of the first camera.
        epsilon: Object width as a fraction of the image width: eps of table 4.1.
        min_presence: Presence probability from which a phrase appears in captions; below 1 minus it, it is missing.
        batch_size: Images per optimiser step.
        augmentation: Strength of the camera augmentation; 0 for none.
        hidden_size: Units of each of the two hidden layers of the relation pooling.
        embedding_dim: Dimension of a pair's embedding.
        initial: What the fit begins with: the convolutions of the grounding model, which stays as it is, or random
            weights. A grounding model that was trained elsewhere needs `scratch`.
        distillation: Weight of the loss that holds the keypoints of phrases where the grounding model finds them in the
            first camera; 0 for none. From scratch, 10 finds them in a few hundred steps.
    """

    phrases: tuple[str, ...] = ()
    epsilon: float = bounded(0.1, least=0.001, most=0.5)
    min_presence: float = bounded(0.95, least=0.55, most=1.0)
    steps: int = bounded(1000, least=1, most=10_000_000)
    batch_size: int = bounded(128, least=2, most=4096)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(50, least=1, most=1_000_000)
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    hidden_size: int = bounded(64, least=1, most=4096)
    embedding_dim: int = bounded(16, least=4, most=64)
    initial: Literal["grounding", "scratch"] = "grounding"
    distillation: float = bounded(0.0, least=0.0, most=1000.0)
