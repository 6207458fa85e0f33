"""Interface of action heads, and the choice of a category."""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from freerein.learning.encoders import FrameTensors
from freerein.types.common import ActionSpec, Camera


class ActionHead(Protocol):
    """The last layers of a policy: a torch module.

    An action is one or several categorical distributions, side by side: D numbers.

    Attributes:
        size: D.
        code_size: M, numbers that the head adds to the code of a frame; 0 for a head that sees no frames.
        draws: U, uniform numbers that a sampled action takes.
    """

    size: int
    code_size: int
    draws: int

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns the head's own features of frames, uint8 (N, H, W, C) by camera: float32 (N, M)."""

    def target(self, actions: Tensor) -> Tensor:
        """Returns executed actions, float32 (..., A) or int64 (..., 1), as distributions: float32 (..., D)."""

    def logits(self, context: Tensor, executed: Tensor) -> Tensor:
        """Returns the logits of distributions, float32 (..., D).

        Args:
            context: Hidden features, then what the head added to the codes of observation and goal: (..., H + 2 M).
            executed: Distributions of the executed actions, which later parts of an action depend on, (..., D).
        """

    def loss(self, logits: Tensor, executed: Tensor) -> Tensor:
        """Returns the cross-entropy, the mean over the parts of an action, float32 (...); arguments (..., D)."""

    def distribution(self, logits: Tensor) -> Tensor:
        """Returns the distributions that logits are of, float32 (..., D)."""

    def act(self, context: Tensor, draws: Tensor | None, *, temperature: float) -> Tensor:
        """Returns actions, float32 (B, A) or int64 (B, 1).

        Args:
            context: As of `logits`, (B, H + 2 M).
            draws: Uniform numbers in [0, 1) that actions are sampled by, (B, U); None for the likeliest action.
            temperature: Divisor of logits before a draw, above 0.
        """


class MakeHead(Protocol):
    """Makes an action head."""

    def __call__(self, hidden: int, action: ActionSpec, cameras: Sequence[Camera], /) -> ActionHead:
        """Returns an untrained head for H hidden features, of the policy's actions and cameras."""


def choose(logits: Tensor, draws: Tensor | None, *, temperature: float) -> Tensor:
    """Returns categories, int64 (...): the likeliest of logits (..., K), or those that draws in [0, 1), (...), select.

    A draw selects the first category up to which the probabilities add up to more than it.
    """
    if draws is None:
        return logits.argmax(dim=-1)
    cumulative = (logits / temperature).softmax(dim=-1).double().cumsum(dim=-1)
    chosen = (cumulative <= draws[..., None] * cumulative[..., -1:]).sum(dim=-1)
    return torch.clamp(chosen, max=logits.shape[-1] - 1)
