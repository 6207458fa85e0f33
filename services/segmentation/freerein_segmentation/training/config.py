"""Configuration of a segmentation fit."""

from dataclasses import dataclass

from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig
from freerein_segmentation.model import Context
from freerein_segmentation.objectives import ObjectiveName


@dataclass(frozen=True)
class SegmentationConfig(FitConfig):
    """Configuration of a segmentation fit; the rest is the network of section 2.3.

    Attributes:
        camera: Camera to learn from; empty for the dataset's only camera.
        objective: `lse`, the dissertation's, or `lse_per_timestep`, ours.
        context: `causal`, the dissertation's, or `bidirectional`.
        use_actions: Whether executed actions are an input.
        stride: Temporal stride in timesteps: 1 where skills may be short; more where they are long, to see more
            trajectories in the same time.
        batch_size: Trajectories per optimiser step.
        features: Number of image features.
        hidden_size: LSTM units per direction.
        validation_fraction: Fraction of trajectories whose tags choose the best weights.
    """

    camera: str = ""
    objective: ObjectiveName = "lse_per_timestep"
    context: Context = "bidirectional"
    use_actions: bool = True
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(1200, least=1, most=10_000_000)
    batch_size: int = bounded(8, least=1, most=1024)
    features: int = bounded(64, least=8, most=1024)
    hidden_size: int = bounded(100, least=8, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)
