"""Configuration of a segmentation fit."""

from dataclasses import dataclass
from typing import Literal

from freerein.learning.config import bounded, bounded_or_all, one_of
from freerein.learning.encoders import ENCODERS
from freerein.learning.fit_config import DatasetFitConfig
from freerein_segmentation.model import MAX_CONTEXT
from freerein_segmentation.objectives import OBJECTIVES


@dataclass(frozen=True)
class SegmentationConfig(DatasetFitConfig):
    """Configuration of a segmentation fit; the rest is the network of section 2.3.

    Attributes:
        objective: Loss of scores against tags.
        context: Future timesteps, one stride apart, that scores depend on, or all; 0 is the dissertation's. A finite
            number makes streams possible.
        encoder: Image encoder.
        initialisation: Of the encoder: `default`, as torch's layers, or `he`, which may leave early plateaus sooner.
        use_actions: Whether executed actions are an input.
        augmentation: Strength of the camera augmentation; 0 for none, as for worlds that are drawn without a camera.
        stride: Temporal stride in timesteps: 1 where skills may be short; more where they are long, to see more
            trajectories in the same time.
        batch_size: Trajectories per optimiser step.
        features: Number of image features.
        hidden_size: LSTM units per direction.
    """

    objective: str = one_of(OBJECTIVES, "lse_per_timestep")
    context: int | Literal["all"] = bounded_or_all("all", least=0, most=MAX_CONTEXT)
    encoder: str = one_of(ENCODERS, "patch")
    initialisation: Literal["default", "he"] = "default"
    use_actions: bool = True
    augmentation: float = bounded(1.0, least=0.0, most=1.0)
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(2000, least=1, most=10_000_000)
    batch_size: int = bounded(8, least=1, most=1024)
    features: int = bounded(64, least=8, most=1024)
    hidden_size: int = bounded(100, least=8, most=1024)
    evaluate_every: int = bounded(100, least=1, most=1_000_000)
