"""What is learned from: images and the actions that were executed, trajectory by trajectory. There are no labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split

D_co = TypeVar("D_co", bound=np.generic, covariant=True)


class Trajectories(Protocol[D_co]):
    """One array (T, ...) per trajectory: a list of arrays, or `freerein.data.cache.StepCache`."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> npt.NDArray[D_co]: ...


@dataclass(frozen=True, eq=False)
class Exploration:
    """Frames and executed actions. Frame t was seen before action t.

    Attributes:
        frames: By trajectory, uint8 (T, H, W, C).
        actions: By trajectory, float32 (T, A) in [-1, 1] or int64 (T, 1).
    """

    frames: Trajectories[np.uint8]
    actions: Trajectories[np.float32] | Trajectories[np.int64]

    def __len__(self) -> int:
        return len(self.frames)

    def lengths(self) -> npt.NDArray[np.int64]:
        """Returns the timesteps of each trajectory, int64 (n,)."""
        return np.array([len(self.actions[item]) for item in range(len(self))], np.int64)

    def subset(self, items: Sequence[int]) -> "Exploration":
        """Returns some of the trajectories, without copying a frame."""
        actions: Any = [self.actions[item] for item in items]
        return Exploration([self.frames[item] for item in items], actions)

    def spread(self, count: int) -> npt.NDArray[np.uint8]:
        """Returns about `count` frames, uint8 (N, H, W, C), spread evenly over trajectories and time."""
        every = max(1, int(self.lengths().sum()) // count)
        return np.concatenate([self.frames[item][item % every :: every] for item in range(len(self))])


def hold_out(exploration: Exploration, *, share: float, seed: int, shortest: int) -> tuple[Exploration, Exploration]:
    """Returns the trajectories to learn from and those held out, a random `share`, at least one of each.

    Args:
        exploration: All trajectories.
        share: Of the trajectories, to hold out.
        seed: Of the draw.
        shortest: Trajectories of fewer timesteps are left out.

    Raises:
        InvalidInput: There are fewer than 2 that are long enough.
    """
    usable = np.flatnonzero(exploration.lengths() >= shortest)
    if len(usable) < 2:
        raise InvalidInput(
            f"A fit needs at least 2 trajectories of {shortest} or more timesteps, one of them to hold out; "
            f"got {len(usable)}.",
            field="dataset",
            hint="Record more, or longer ones: freerein sim demonstrate TASK --behaviour random --out NAME.",
        )
    learnt, held_out = train_validation_split(usable, fraction=share, seed=seed)
    return exploration.subset(learnt), exploration.subset(held_out)
