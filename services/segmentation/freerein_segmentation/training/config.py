"""What a fit may choose."""

from collections.abc import Mapping
from dataclasses import dataclass

from freerein.learning.config import bounded, parse
from freerein.learning.fit import Plan
from freerein_segmentation.model import Context
from freerein_segmentation.objectives import ObjectiveName


@dataclass(frozen=True)
class SegmentationConfig:
    """Everything that a fit may choose; the rest is the network of section 2.3.

    Attributes:
        camera: Whose frames to learn from; empty where the dataset has one camera.
        stride: Timesteps from one that the network sees to the next: 1 where skills may last a few timesteps only, more
            where they are long and frames alike, to see more trajectories in the same time.
        objective: `lse`, the dissertation's, or `lse_per_timestep`, ours.
        context: `causal`, the dissertation's, or `bidirectional`: labelling is done after the fact.
        use_actions: Whether the network sees the executed actions.
        steps: Updates.
        batch_size: Trajectories per update.
        learning_rate: Of Adam, at its highest: it rises over `warmup_steps` and falls to zero as a cosine.
        warmup_steps: Updates.
        features: Image features.
        hidden: Units of the LSTM, in each direction.
        validation_share: The share of trajectories held out to choose the best weights, by their tags alone.
        evaluate_every: Updates between looks at the held-out trajectories.
        checkpoint_every: Updates between checkpoints.
        log_every: Updates between rows of metrics.
        seed: Of every random draw.
        threads: Of torch on the CPU; one is usually as fast as two, the network being small.
    """

    camera: str = ""
    objective: ObjectiveName = "lse_per_timestep"
    context: Context = "bidirectional"
    use_actions: bool = True
    stride: int = bounded(1, least=1, most=100)
    steps: int = bounded(1200, least=1, most=10_000_000)
    batch_size: int = bounded(8, least=1, most=1024)
    learning_rate: float = bounded(2e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(30, least=1, most=1_000_000)
    features: int = bounded(64, least=8, most=1024)
    hidden: int = bounded(100, least=8, most=1024)
    validation_share: float = bounded(0.1, least=0.01, most=0.5)
    evaluate_every: int = bounded(50, least=1, most=1_000_000)
    checkpoint_every: int = bounded(100, least=1, most=1_000_000)
    log_every: int = bounded(10, least=1, most=1_000_000)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    threads: int = bounded(1, least=1, most=256)

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> "SegmentationConfig":
        """Returns the configuration that `values` describe; what is left out has its default.

        Raises:
            InvalidInput: A key is unknown, or a value has the wrong type or is out of bounds.
        """
        return parse(cls, values)

    @property
    def plan(self) -> Plan:
        """How long to train, and how often to look."""
        return Plan(
            steps=self.steps,
            batch_size=self.batch_size,
            evaluate_every=self.evaluate_every,
            checkpoint_every=self.checkpoint_every,
            log_every=self.log_every,
            seed=self.seed,
            threads=self.threads,
        )
