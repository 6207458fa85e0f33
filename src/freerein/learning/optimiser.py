"""One Adam step with clipped gradients, and the learning-rate schedule."""

import math
from dataclasses import replace

from torch import Tensor, nn

from freerein.learning.train_state import N, TrainState

IMPORTED_BY_OPTIMISERS = "torch._dynamo"
"""The module that torch imports, for a second of CPU, when a process makes its first optimiser."""

_MAX_GRAD_NORM = 1.0


def optimiser_step(state: TrainState[N], loss: Tensor, *, lr: float) -> TrainState[N]:
    """Returns the state after one gradient step on a scalar loss, at the learning rate `lr`."""
    for group in state.optimiser.param_groups:
        group["lr"] = lr
    state.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
    nn.utils.clip_grad_norm_(state.network.parameters(), _MAX_GRAD_NORM)
    state.optimiser.step()
    return replace(state, step=state.step + 1)


def cosine_lr(peak: float, step: int, *, warmup_steps: int, steps: int) -> float:
    """Returns the learning rate at `step`, counted from 0: linear warm-up to `peak`, times a cosine decay to zero."""
    warmup = min(1.0, (step + 1) / warmup_steps)
    return peak * warmup * 0.5 * (1.0 + math.cos(math.pi * step / steps))
