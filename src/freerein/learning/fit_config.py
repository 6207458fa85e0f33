"""The configuration keys that every fit shares."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from freerein.config import bounded, parse


@dataclass(frozen=True)
class FitConfig:
    """Base configuration of a fit; each kind of fit adds keys and may change defaults.

    Attributes:
        steps: Optimiser steps.
        batch_size: Items per optimiser step.
        lr: Peak learning rate of Adam: linear warm-up over `warmup_steps`, then cosine decay to zero.
        warmup_steps: Optimiser steps of the learning rate's warm-up.
        evaluate_every: Optimiser steps between evaluations on the validation split.
        checkpoint_every: Optimiser steps between checkpoints.
        log_every: Optimiser steps between rows of metrics.
        seed: Seed of every random draw.
        threads: Torch threads on the CPU; one is usually as fast as two, because the networks are small.
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
        """Returns the configuration of the given values; see `freerein.config.parse`."""
        return parse(cls, values)


@dataclass(frozen=True)
class DatasetFitConfig(FitConfig):
    """Base configuration of a fit to a dataset.

    Attributes:
        cameras: Cameras to learn from; the dataset's first when empty.
        validation_fraction: Fraction of trajectories held out, whose training signal chooses the best weights.
    """

    cameras: tuple[str, ...] = ()
    validation_fraction: float = bounded(0.1, least=0.01, most=0.5)
