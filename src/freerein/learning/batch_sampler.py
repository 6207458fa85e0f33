"""Minibatch sampling without replacement, with a state that can be saved."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(eq=False)
class BatchSampler:
    """Draws minibatches without replacement, epoch after epoch; the last, incomplete batch of an epoch is dropped.

    Attributes:
        rng: Generator of each epoch's permutation.
        order: int64 (n,), the permutation of the current epoch.
        position: Number of items of `order` already drawn.
    """

    rng: np.random.Generator
    order: npt.NDArray[np.int64]
    position: int

    @classmethod
    def start(cls, count: int, *, rng: np.random.Generator) -> "BatchSampler":
        """Returns the sampler of `count` items before its first batch."""
        return cls(rng, rng.permutation(count), 0)

    def next_batch(self, batch_size: int) -> npt.NDArray[np.int64]:
        """Returns the indices of the next batch, int64 (min(batch_size, n),)."""
        size = min(batch_size, len(self.order))
        if self.position + size > len(self.order):
            self.order, self.position = self.rng.permutation(len(self.order)), 0
        self.position += size
        return self.order[self.position - size : self.position]
