"""What a language policy learns from: what policies saw and did, and what they were told to do."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.split import train_validation_split
from freerein_imitation.training.exploration import Exploration


@dataclass(frozen=True, eq=False)
class Batch:
    """Some timesteps.

    Attributes:
        frames: uint8 (B, H, W, C).
        codes: Of what was to be done, float32 (B, W).
        actions: float32 (B, A) or int64 (B, 1).
    """

    frames: Tensor
    codes: Tensor
    actions: Tensor


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Trajectories, each with the goal text that it was made for.

    Attributes:
        exploration: Frames and executed actions.
        texts: Of each trajectory, its goal text.
        codes: Of each different goal text, float32 (W,).
    """

    exploration: Exploration
    texts: tuple[str, ...]
    codes: dict[str, npt.NDArray[np.float32]]

    def __len__(self) -> int:
        """Returns the timesteps of all trajectories together."""
        return int(self._ends[-1])

    @cached_property
    def _ends(self) -> npt.NDArray[np.int64]:
        return np.cumsum(self.exploration.lengths())

    def subset(self, items: Sequence[int]) -> "Rollouts":
        """Returns some of the trajectories, without copying a frame."""
        return Rollouts(self.exploration.subset(items), tuple(self.texts[item] for item in items), self.codes)

    def different_codes(self) -> Tensor:
        """Returns the code of each different goal text, float32 (n, W)."""
        return torch.from_numpy(np.stack([self.codes[text] for text in sorted(set(self.texts))]))

    def gather(self, timesteps: npt.NDArray[np.int64], *, device: torch.device) -> Batch:
        """Returns timesteps, int64 (B,), counted over all trajectories, as tensors on a device."""
        items = np.searchsorted(self._ends, timesteps, side="right")
        places = list(zip(items.tolist(), (timesteps - self._ends[items]).tolist(), strict=True))  # from each end
        frames = np.stack([self.exploration.frames[item][t] for item, t in places])
        codes = np.stack([self.codes[self.texts[item]] for item, _ in places])
        actions = np.stack([self.exploration.actions[item][t] for item, t in places])
        return Batch(*(torch.from_numpy(each).to(device) for each in (frames, codes, actions)))


def hold_out(rollouts: Rollouts, *, share: float, seed: int) -> tuple[Rollouts, Rollouts]:
    """Returns the trajectories to learn from and those held out: a random `share` of those of each goal text.

    Of a goal text with a single trajectory none is held out.

    Raises:
        InvalidInput: No goal text has two trajectories.
    """
    learnt, held_out = list[int](), list[int]()
    for text in sorted(set(rollouts.texts)):
        items = [item for item, each in enumerate(rollouts.texts) if each == text]
        sides = train_validation_split(items, fraction=share, seed=seed) if len(items) > 1 else (items, [])
        learnt += sides[0]
        held_out += sides[1]
    if not held_out:
        raise InvalidInput(
            f"A fit needs at least 2 trajectories of a goal text, one of them to hold out; got {len(rollouts.texts)} "
            "trajectories, each of another.",
            field="dataset",
            hint="Roll out each policy more than once.",
        )
    return rollouts.subset(sorted(learnt)), rollouts.subset(sorted(held_out))


def random_crop(frames: Tensor, *, smallest: float, generator: torch.Generator) -> Tensor:
    """Returns frames of which a random part, of the same proportions, fills the whole, to the nearest pixel.

    Args:
        frames: uint8 (B, H, W, C).
        smallest: The smallest share of a frame's area that is left, in (0, 1].
        generator: On the CPU.
    """
    share, *offsets = torch.rand(3, len(frames), 1, generator=generator)  # (B, 1) each
    side = (smallest + (1 - smallest) * share).sqrt()
    rows, columns = (
        ((torch.arange(length) + 0.5) * side + offset * (1 - side) * length).long()  # (B, length)
        for length, offset in zip(frames.shape[1:3], offsets, strict=True)
    )
    frame = torch.arange(len(frames))[:, None]
    pixels = (frame * frames.shape[1] + rows)[:, :, None] * frames.shape[2] + columns[:, None]  # (B, H, W)
    return frames.flatten(0, 2).index_select(0, pixels.flatten().to(frames.device)).view(frames.shape)
