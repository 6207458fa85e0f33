"""Heads of actions whose numbers do not depend on each other: one linear layer."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from freerein.learning.encoders import FrameTensors
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.action_heads.action_head import choose
from freerein_imitation.methods.shared.action_heads.pick_and_place import picks_and_places
from freerein_imitation.methods.shared.losses import action_cross_entropy


class _IndependentHead(nn.Linear):
    """Base: a categorical distribution of each number of an action, of `shape` (A, categories)."""

    code_size = 0

    def __init__(self, hidden: int, action: ActionSpec, _cameras: Sequence[Camera] = ()) -> None:
        self.shape = action.size, action.choices or action_bins.BINS
        self.size = math.prod(self.shape)
        self.draws = action.size
        super().__init__(hidden, self.size)
        self._action = action

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns codes of no numbers; see `ActionHead`."""
        first = next(iter(frames.values()))
        return torch.zeros((len(first), 0), device=first.device)

    def target(self, actions: Tensor) -> Tensor:
        """Returns actions as distributions; see `ActionHead`."""
        return action_bins.encode(actions, choices=self._action.choices).flatten(-2)

    def logits(self, context: Tensor, _executed: Tensor | None = None) -> Tensor:
        """Returns logits; see `ActionHead`."""
        logits: Tensor = self(context)
        return logits

    def loss(self, logits: Tensor, executed: Tensor) -> Tensor:
        """Returns the loss L(a_t, â_t) of eq. 3.2; see `ActionHead`."""
        return action_cross_entropy(self._by_number(logits), self._by_number(executed))

    def distribution(self, logits: Tensor) -> Tensor:
        """Returns distributions; see `ActionHead`."""
        return self._by_number(logits).softmax(dim=-1).flatten(-2)

    def _by_number(self, flat: Tensor) -> Tensor:
        """Returns logits or distributions (..., D) as (..., A, categories)."""
        return flat.view(*flat.shape[:-1], *self.shape)


class CategoricalHead(_IndependentHead):
    """One of some choices: the likeliest, or one that is drawn."""

    def act(self, context: Tensor, draws: Tensor | None, *, temperature: float) -> Tensor:
        """Returns choices, int64 (B, 1); see `ActionHead`."""
        return choose(self._by_number(self.logits(context)), draws, temperature=temperature)


class BinsHead(_IndependentHead):
    """Numbers in bins: their means, or bins that are drawn.

    The mean of several pick points is none of them: of a pick point the likeliest bin is executed, with its neighbours.
    """

    def act(self, context: Tensor, draws: Tensor | None, *, temperature: float) -> Tensor:
        """Returns numbers, float32 (B, A); see `ActionHead`."""
        logits = self._by_number(self.logits(context))  # (B, A, BINS)
        if draws is not None:
            return action_bins.centres(logits.device)[choose(logits, draws, temperature=temperature)]
        numbers = action_bins.decode(logits, choices=0)
        if picks_and_places(self._action):
            numbers[:, :2] = action_bins.decode_mode(logits[:, :2])
        return numbers
