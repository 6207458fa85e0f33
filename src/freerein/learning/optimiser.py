"""How weights follow a loss: Adam, clipped gradients, and a learning rate that rises and falls."""

import math
from dataclasses import replace

from torch import Tensor, nn

from freerein.learning.train_state import N, TrainState

_GRADIENT_NORM = 1.0


def optimiser_step(state: TrainState[N], loss: Tensor, *, lr: float) -> TrainState[N]:
    """Returns the state after one update that lowers a loss.

    Args:
        state: Before it.
        loss: A number that depends on the state's network.
        lr: The learning rate.
    """
    for group in state.optimiser.param_groups:
        group["lr"] = lr
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    nn.utils.clip_grad_norm_(state.network.parameters(), _GRADIENT_NORM)
    state.optimiser.step()
    return replace(state, step=state.step + 1)


def cosine_lr(highest: float, step: int, *, warmup_steps: int, steps: int) -> float:
    """Returns the learning rate of the update after `step` others: a linear rise, then half a cosine down to zero."""
    rise = min(1.0, (step + 1) / warmup_steps)
    return highest * rise * 0.5 * (1.0 + math.cos(math.pi * step / steps))
