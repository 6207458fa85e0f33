"""What a fit may choose."""

from dataclasses import dataclass

from freerein.learning.config import bounded
from freerein.learning.fit_config import FitConfig
from freerein_segmentation.model import Context
from freerein_segmentation.objectives import ObjectiveName


@dataclass(frozen=True)
class SegmentationConfig(FitConfig):
    """Everything that a fit may choose; the rest is the network of section 2.3.

    Attributes:
        camera: Whose frames to learn from; empty where the dataset has one camera.
        stride: Timesteps from one that the network sees to the next: 1 where skills may last a few timesteps only, more
            where they are long and frames alike, to see more trajectories in the same time.
        objective: `lse`, the dissertation's, or `lse_per_timestep`, ours.
        context: `causal`, the dissertation's, or `bidirectional`: labelling is done after the fact.
        use_actions: Whether the network sees the executed actions.
        batch_size: Trajectories per update.
        features: Image features.
        hidden: Units of the LSTM, in each direction.
        validation_fraction: The share of trajectories held out to choose the best weights, by their tags alone.
    """

    camera: str = ""
    objective: ObjectiveName = "lse_per_timestep"
    context: Context = "bidirectional"
    use_actions: bool = True
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(1200, least=1, most=10_000_000)
    batch_size: int = bounded(8, least=1, most=1024)
    features: int = bounded(64, least=8, most=1024)
    hidden: int = bounded(100, least=8, most=1024)
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)
