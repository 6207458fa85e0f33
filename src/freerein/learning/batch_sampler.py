"""The order in which a training sees its items, as a state that can be saved."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(eq=False)
class BatchSampler:
    """Draws batches without replacement, epoch after epoch; what does not fill a batch at an epoch's end is left out.

    Attributes:
        rng: Draws each epoch's order.
        order: int64 (n,), the present epoch's order.
        position: How many of `order` have been drawn.
    """

    rng: np.random.Generator
    order: npt.NDArray[np.int64]
    position: int

    @classmethod
    def start(cls, count: int, *, rng: np.random.Generator) -> "BatchSampler":
        """Returns the state before the first batch of `count` items."""
        return cls(rng, rng.permutation(count), 0)

    def next_batch(self, batch_size: int) -> npt.NDArray[np.int64]:
        """Returns the items of the next batch, int64 (min(batch_size, n),)."""
        size = min(batch_size, len(self.order))
        if self.position + size > len(self.order):
            self.order, self.position = self.rng.permutation(len(self.order)), 0
        self.position += size
        return self.order[self.position - size : self.position]
