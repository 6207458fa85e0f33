"""The memory of a skill policy between two observations, as one flat vector: the API's `state` holds it.

Frames are remembered as features, newest first, beside the actions executed before them. Chunks of actions that were
predicted for the next timesteps are averaged (temporal ensembling; Zhao et al., "Learning fine-grained bimanual
manipulation with low-cost hardware", 2023); those for another skill are dropped.

Whether a skill has ended is averaged over frames, too, with more weight on later ones: a robot that passes what looks
like an end does not stay there. A frame counts once, however many timesteps there are to the next.

Where a robot executes several actions before it observes again, predictions for the timesteps in between drop out. As
training saw frames of consecutive timesteps, a motion counts per timestep; to take earlier frames for unknown, as at
the start of an episode, would lose velocities. A policy gets only the last of the executed actions, and training saw
none before it only at that start: those before it count as unknown.

Callers may change a state, so that any finite numbers must be taken: rates and counts are clamped.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

_DECAY = 0.7
"""Weight of a prediction relative to one that was made a timestep later."""

_END_DECAY = 0.5
"""The same for the probability that a skill has ended; before its first frame the probability is 0."""


@dataclass(frozen=True)
class MemorySizes:
    """Sizes of a memory.

    Attributes:
        frames: Earlier frames.
        features: D, features of a frame.
        actions: Executed actions.
        action_size: E, numbers of an action as a network takes it.
        chunk: K, actions of a chunk.
        outputs: O, numbers of a predicted action.
    """

    frames: int
    features: int
    actions: int
    action_size: int
    chunk: int
    outputs: int

    @property
    def total(self) -> int:
        """R, numbers of the flat vector."""
        return sum(self.parts)

    @property
    def parts(self) -> tuple[int, ...]:
        """Numbers of each part: rates and features of frames, actions, skill, end, weights and sums of predictions."""
        window = (self.frames, self.frames * self.features, self.actions * self.action_size)
        return (*window, 1, 1, self.chunk, self.chunk * self.outputs)


@dataclass(frozen=True, eq=False)
class Memory:
    """Memories of B robots.

    Attributes:
        rates: Of earlier frames, 1 / timesteps from each to the next frame, 0 for none: float32 (B, n), newest first.
        features: Of earlier frames, float32 (B, n, D), newest first.
        actions: Executed ones, float32 (B, m, E), newest first.
        skill: Index of the skill that predictions are for, plus 1; 0 for none: float32 (B,).
        ended: Averaged probability that it has ended, float32 (B,).
        weights: Of the predictions for each of the next timesteps, float32 (B, K).
        sums: Weighted sums of them, float32 (B, K, O).
    """

    rates: Tensor
    features: Tensor
    actions: Tensor
    skill: Tensor
    ended: Tensor
    weights: Tensor
    sums: Tensor

    @classmethod
    def parse(cls, flat: Tensor, sizes: MemorySizes, *, no_action: Tensor) -> "Memory":
        """Returns the memories in flat vectors, float32 (B, R), of any finite numbers.

        They are zeros at the start of an episode; `no_action` stands for actions before it, float32 (E,).
        """
        rates, features, actions, skill, ended, weights, sums = torch.split(flat, list(sizes.parts), dim=1)
        is_start = (flat == 0).all(dim=1)[:, None, None]
        return cls(
            rates.clamp(0, 1),
            features.reshape(flat.shape[0], sizes.frames, sizes.features),
            torch.where(is_start, no_action, actions.reshape(flat.shape[0], sizes.actions, sizes.action_size)),
            skill[:, 0],
            ended[:, 0].clamp(0, 1),
            weights.clamp(0.0, 1 / (1 - _DECAY)),
            sums.reshape(flat.shape[0], sizes.chunk, sizes.outputs),
        )

    def flat(self) -> Tensor:
        """Returns the flat vectors, float32 (B, R)."""
        window = (self.rates, self.features, self.actions)
        parts = (*window, self.skill[:, None], self.ended[:, None], self.weights, self.sums)
        return torch.cat([each.flatten(1) for each in parts], dim=1)

    def skipped(self, steps: Tensor, *, no_action: Tensor) -> "Memory":
        """Returns the memories after timesteps without a frame.

        Args:
            steps: How many, int64 (B,); with 0 a memory stays as it is.
            no_action: Stands for an unknown action, float32 (E,).
        """
        weights, sums = self.weights, self.sums
        for past in range(min(int(steps.max()), weights.shape[1])):
            is_later = steps > past
            weights = torch.where(is_later[:, None], _later(weights), weights)
            sums = torch.where(is_later[:, None, None], _later(sums), sums)
        latest = self.rates[:, :1]  # (B, 1), or (B, 0)
        rates = torch.cat([latest / (1 + steps[:, None] * latest), self.rates[:, 1:]], dim=1)
        actions = torch.where((steps > 0)[:, None, None], no_action, self.actions)
        return replace(self, rates=rates, actions=actions, weights=weights, sums=sums)

    def without_skill(self) -> "Memory":
        """Returns the memories of no skill: the next one, even of the same name, begins anew."""
        return replace(self, skill=torch.zeros_like(self.skill))

    def with_action(self, action: Tensor) -> "Memory":
        """Returns the memories after an action (B, E) was executed."""
        actions = torch.cat([action[:, None], self.actions], dim=1)[:, : self.actions.shape[1]]
        return replace(self, actions=actions)

    def advanced(self, features: Tensor, skill: Tensor, chunk: Tensor, ended: Tensor) -> tuple["Memory", Tensor]:
        """Returns the memories after a frame, and the averaged chunks, float32 (B, K, O).

        Args:
            features: Of the frame, float32 (B, D).
            skill: Index of the current skill, int64 (B,).
            chunk: Predictions from the frame, the first for its own timestep, float32 (B, K, O).
            ended: Probability that the skill has ended, float32 (B,).
        """
        same = self.skill == skill + 1
        weights = torch.where(same[:, None], self.weights, 0.0) + 1
        sums = torch.where(same[:, None, None], self.sums, 0.0) + chunk
        ended = averaged_end(torch.where(same, self.ended, 0.0), ended)
        rates = torch.cat([torch.ones_like(self.rates[:, :1]), self.rates], dim=1)[:, : self.rates.shape[1]]
        seen = torch.cat([features[:, None], self.features], dim=1)[:, : self.features.shape[1]]
        later = Memory(rates, seen, self.actions, (skill + 1).float(), ended, _later(weights), _later(sums))
        return later, sums / weights[..., None]


def averaged_end(before: Tensor, ended: Tensor) -> Tensor:
    """Returns the averaged probability after one more frame, of that before it and the frame's own, float32 (B,)."""
    return _END_DECAY * before + (1 - _END_DECAY) * ended


def _later(values: Tensor) -> Tensor:
    """Returns predictions, (B, K, ...), shifted to the next timestep, with less weight."""
    return _DECAY * torch.cat([values[:, 1:], torch.zeros_like(values[:, :1])], dim=1)
