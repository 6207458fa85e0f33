"""Training data of a language policy: trajectories with goal texts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.augmentation import shift
from freerein.learning.encoders import FrameTensors
from freerein.learning.split import train_validation_split
from freerein.learning.trajectories import Trajectories
from freerein_imitation.methods.language.contradictions import contradictions


@dataclass(frozen=True, eq=False)
class TimestepBatch:
    """B timesteps.

    Attributes:
        frames: By camera, uint8 (B, H, W, C); empty where `seen` stands for them.
        seen: Their encoding by the object encoder, float32 (B, D); None without one.
        texts: Codes of the goal texts, float32 (B, code size).
        actions: float32 (B, A) or int64 (B, 1).
        judged: Labels by a reward model; None where it was not asked.
    """

    frames: FrameTensors
    seen: Tensor | None
    texts: Tensor
    actions: Tensor
    judged: "Judged | None"


@dataclass(frozen=True, eq=False)
class Judged:
    """What is known of B frames and texts.

    Attributes:
        reached: Whether the frames show the goal, bool (B,).
        rivals: Codes of texts that contradict the goal texts, float32 (B, code size).
        is_rivalled: Where there is such a text, bool (B,); elsewhere the rival is the goal text itself.
    """

    reached: Tensor
    rivals: Tensor
    is_rivalled: Tensor


@dataclass(frozen=True, eq=False)
class GoalTextDataset:
    """Trajectories, each with its goal text.

    Attributes:
        trajectories: Trajectories with goal texts.
        codes: Code of each distinct goal text, float32 (code size,).
        rivals: The other texts that contradict each distinct goal text.
        seen: Encoding of each trajectory's frames by the object encoder, float32 (T, D); empty without one.
    """

    trajectories: Trajectories
    codes: dict[str, npt.NDArray[np.float32]]
    rivals: Mapping[str, Sequence[str]]
    seen: Sequence[npt.NDArray[np.float32]] = ()

    @classmethod
    def of(
        cls,
        trajectories: Trajectories,
        codes: dict[str, npt.NDArray[np.float32]],
        *,
        seen: Sequence[npt.NDArray[np.float32]] = (),
    ) -> "GoalTextDataset":
        """Returns the dataset of trajectories, the codes of their texts, and what an object encoder sees of them."""
        return cls(trajectories, codes, contradictions(list(codes)), seen)

    def __len__(self) -> int:
        """Returns the timesteps of all trajectories together."""
        return int(self._ends[-1])

    @cached_property
    def _ends(self) -> npt.NDArray[np.int64]:
        return np.cumsum(self.trajectories.lengths())

    def subset(self, items: Sequence[int]) -> "GoalTextDataset":
        """Returns some of the trajectories, without copying frames."""
        seen = [self.seen[item] for item in items] if self.seen else ()
        return replace(self, trajectories=self.trajectories.subset(items), seen=seen)

    def distinct_codes(self) -> Tensor:
        """Returns the codes of the distinct goal texts, float32 (n, code size)."""
        return torch.from_numpy(np.stack([self.codes[text] for text in sorted(set(self.trajectories.goal_texts))]))

    def collate(self, timesteps: npt.NDArray[np.int64], *, device: torch.device) -> TimestepBatch:
        """Returns a batch of timesteps, int64 (B,), which count over all trajectories."""
        items = np.searchsorted(self._ends, timesteps, side="right")
        places = list(zip(items.tolist(), (timesteps - self._ends[items]).tolist(), strict=True))  # from each end
        frames = {} if self.seen else self.trajectories.frames_at([(i, np.array([t])) for i, t in places], device)
        texts, seen, actions = (
            torch.from_numpy(each).to(device)
            for each in (self._codes[self._texts[items]], self._seen[timesteps], self._actions[timesteps])
        )
        return TimestepBatch(frames, seen if self.seen else None, texts, actions, self._judged(places, device))

    @cached_property
    def _texts(self) -> npt.NDArray[np.int64]:
        """Number of each trajectory's text among the codes, int64 (n,)."""
        numbers = {text: number for number, text in enumerate(self.codes)}
        return np.array([numbers[text] for text in self.trajectories.goal_texts], np.int64)

    @cached_property
    def _codes(self) -> npt.NDArray[np.float32]:
        return np.stack(list(self.codes.values()))

    @cached_property
    def _seen(self) -> npt.NDArray[np.float32]:
        return np.concatenate(self.seen) if self.seen else np.zeros((len(self), 0), np.float32)

    @cached_property
    def _actions(self) -> npt.NDArray[Any]:
        return np.concatenate([self.trajectories.actions[item] for item in range(len(self.trajectories))])

    def _judged(self, places: Sequence[tuple[int, int]], device: torch.device) -> Judged | None:
        """Returns what is known of the frames at timesteps of trajectories; a timestep has the same rival each time."""
        if not self.trajectories.reached:
            return None
        reached = [self.trajectories.reached[item][t] for item, t in places]
        texts = [self.trajectories.goal_texts[item] for item, _ in places]
        among = [self.rivals[text] for text in texts]
        chosen = [
            each[t % len(each)] if each else text for text, each, (_, t) in zip(texts, among, places, strict=True)
        ]
        rivals = _stack([self.codes[text] for text in chosen], device)
        return Judged(_stack(reached, device), rivals, _stack([np.bool_(len(each) > 0) for each in among], device))


def split_by_text(dataset: GoalTextDataset, *, fraction: float, seed: int) -> tuple[GoalTextDataset, GoalTextDataset]:
    """Returns training and validation trajectories; `fraction` of each goal text's trajectories are for validation.

    A goal text with a single trajectory is for training only.

    Raises:
        InvalidInput: No goal text has two trajectories.
    """
    training, validation = list[int](), list[int]()
    goal_texts = dataset.trajectories.goal_texts
    for text in sorted(set(goal_texts)):
        items = [item for item, each in enumerate(goal_texts) if each == text]
        sides = train_validation_split(items, fraction=fraction, seed=seed) if len(items) > 1 else (items, [])
        training += sides[0]
        validation += sides[1]
    if not validation:
        raise InvalidInput(
            "A fit needs at least 2 trajectories of a goal text, one of them for validation; "
            f"got {len(goal_texts)} trajectories, each with a goal text of its own.",
            field="dataset",
            hint="Roll out each policy more than once.",
        )
    return dataset.subset(sorted(training)), dataset.subset(sorted(validation))


def random_shift(frames: Tensor, *, most: float, generator: torch.Generator) -> Tensor:
    """Returns frames shifted by whole pixels, edges replicated: what is seen stays as far apart as it was.

    Args:
        frames: uint8 (B, H, W, C).
        most: Largest shift along each axis, as a share of the frame's side.
        generator: On the CPU.
    """
    reaches = [round(most * side) for side in frames.shape[1:3]]
    drawn = [torch.randint(-reach, reach + 1, (len(frames), 1), generator=generator) for reach in reaches]
    return shift(frames, torch.cat(drawn, dim=1).to(frames.device))


def _stack(arrays: Sequence[npt.NDArray[Any] | np.bool_], device: torch.device) -> Tensor:
    return torch.from_numpy(np.stack(arrays)).to(device)
