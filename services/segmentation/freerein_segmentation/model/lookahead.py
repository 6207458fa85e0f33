"""The lookahead of scores, and the recurrent layer that provides it."""

from typing import Literal, TypeAlias

import torch
from torch import Tensor, nn

Context: TypeAlias = int | Literal["all"]
"""Future timesteps that a score depends on: 0 is the dissertation's causal network, `all` a bidirectional one."""

MAX_CONTEXT = 200

_INPUTS_AT_ONCE = 1 << 14


def look_ahead(lstm: nn.LSTM, features: Tensor, remaining: Tensor, *, context: int) -> Tensor:
    """Returns the memory, float (N, H), of up to `context` timesteps after each of the first N.

    For each timestep the LSTM starts afresh, reads its future backwards and ends at the timestep itself. So the result
    depends on nothing later, and is the same whether the future is known at once or arrives bit by bit.

    Args:
        lstm: The recurrent layer, batch first.
        features: float (M, D), M at least N.
        remaining: int64 (N,), timesteps of the same trajectory that follow each.
        context: Most timesteps to read after each.
    """
    rows = torch.arange(len(remaining), device=features.device)  # (N,)
    ahead = remaining.clamp(max=context)
    offsets = torch.arange(context + 1, device=features.device)
    memory = [features.new_zeros(0, lstm.hidden_size)]
    at_once = max(1, _INPUTS_AT_ONCE // (context + 1))
    for first, last in zip(torch.split(rows, at_once), torch.split(ahead, at_once), strict=True):
        places = ((first + last)[:, None] - offsets).clamp(min=first[:, None])  # (n, context + 1)
        output, _ = lstm(features[places])  # (n, context + 1, H)
        memory.append(output[torch.arange(len(first)), last])  # read up to the timestep itself
    return torch.cat(memory)


def countdown(features: Tensor) -> Tensor:
    """Returns how many rows follow each of features (N, D), int64 (N,)."""
    return torch.arange(len(features) - 1, -1, -1, device=features.device)
