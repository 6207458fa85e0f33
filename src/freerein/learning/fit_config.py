"""What every fit may choose."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from freerein.learning.config import bounded, parse
from freerein.learning.fit import FitPlan


@dataclass(frozen=True)
class FitConfig:
    """What every fit may choose; each kind of fit adds what is its own, and may have other defaults.

    Attributes:
        steps: Updates.
        batch_size: Items per update.
        lr: Of Adam, at its highest: it rises over `warmup_steps` and falls to zero as a cosine.
        warmup_steps: Updates.
        evaluate_every: Updates between looks at what is held out.
        checkpoint_every: Updates between checkpoints.
        log_every: Updates between rows of metrics.
        seed: Of every random draw.
        threads: Of torch on the CPU; one is usually as fast as two, the networks being small.
    """

    steps: int = bounded(1000, least=1, most=10_000_000)
    batch_size: int = bounded(64, least=1, most=4096)
    lr: float = bounded(2e-3, least=1e-7, most=1.0)
    warmup_steps: int = bounded(30, least=1, most=1_000_000)
    evaluate_every: int = bounded(100, least=1, most=1_000_000)
    checkpoint_every: int = bounded(100, least=1, most=1_000_000)
    log_every: int = bounded(10, least=1, most=1_000_000)
    seed: int = bounded(0, least=0, most=2**31 - 1)
    threads: int = bounded(1, least=1, most=256)

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> Self:
        """Returns the configuration that `values` describe; what is left out has its default.

        Raises:
            InvalidInput: A key is unknown, or a value has the wrong type or is out of bounds.
        """
        return parse(cls, values)

    @property
    def plan(self) -> FitPlan:
        """How long to train, and how often to look."""
        return FitPlan(
            steps=self.steps,
            batch_size=self.batch_size,
            evaluate_every=self.evaluate_every,
            checkpoint_every=self.checkpoint_every,
            log_every=self.log_every,
            seed=self.seed,
            threads=self.threads,
        )
