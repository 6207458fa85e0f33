"""Configuration of the grounding model's training."""

from dataclasses import dataclass

from freerein.config import bounded
from freerein.learning.fit_config import FitConfig


@dataclass(frozen=True)
class GroundingConfig(FitConfig):
    """Configuration of the grounding model's pretraining.

    Attributes:
        train_images: Number of synthetic training images; each is rendered from its index.
        validation_images: Number of synthetic validation images.
        batch_size: Images per optimiser step.
        width: Channels of the image encoder's stem.
        depth: Bottlenecks per stage.
        embedding_dim: Dimension of the embeddings.
    """

    train_images: int = bounded(100_000, least=1, most=100_000_000)
    validation_images: int = bounded(512, least=2, most=100_000)
    steps: int = bounded(1200, least=1, most=10_000_000)
    batch_size: int = bounded(64, least=2, most=4096)
    lr: float = bounded(3e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(50, least=1, most=1_000_000)
    width: int = bounded(8, least=8, most=128)
    depth: int = bounded(1, least=1, most=8)
    embedding_dim: int = bounded(64, least=8, most=1024)
    evaluate_every: int = bounded(200, least=1, most=1_000_000)
