"""The base of heads that choose a location, then a direction, then a length."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein_imitation.methods.shared.action_heads.action_head import choose
from freerein_imitation.methods.shared.action_heads.pick_and_place import (
    DIRECTIONS,
    LENGTHS,
    LOCATIONS,
    PARTS,
    decode,
    encode,
    places_around,
)
from freerein_imitation.methods.shared.losses import action_cross_entropy

_UNITS = 200


class Locations(NamedTuple):
    """Logits and features of the locations.

    Attributes:
        hidden: Hidden features, float32 (B, H).
        logits: float32 (B, LOCATIONS).
        features: Of each location, float32 (LOCATIONS, P), or (B, LOCATIONS, P).
    """

    hidden: Tensor
    logits: Tensor
    features: Tensor


class PickHead(nn.Module, ABC):
    """Direction depends on the location, length on both: on executed ones in training, on chosen ones in acting.

    Args:
        hidden: H, hidden features.
        features: P, features of a location.
    """

    size = sum(PARTS)
    draws = len(PARTS)

    def __init__(self, hidden: int, features: int) -> None:
        super().__init__()
        self.direction = perceptron(hidden + features, DIRECTIONS)
        self.length = perceptron(hidden + features + DIRECTIONS, LENGTHS)

    @abstractmethod
    def locations(self, context: Tensor) -> Locations:
        """Returns logits of the locations, given contexts float32 (B, H + 2 M)."""

    def target(self, actions: Tensor) -> Tensor:
        """Returns actions as distributions; see `ActionHead`."""
        return encode(actions)

    def logits(self, context: Tensor, executed: Tensor) -> Tensor:
        """Returns logits; see `ActionHead`."""
        found = self.locations(context.flatten(end_dim=-2))
        location, direction, _ = parts_of(executed.flatten(end_dim=-2))
        rest = self._direction_and_length(found, location, direction)
        return torch.cat([found.logits, *rest], dim=1).view(*context.shape[:-1], self.size)

    def loss(self, logits: Tensor, executed: Tensor) -> Tensor:
        """Returns the mean cross-entropy of location, direction and length; see `ActionHead`."""
        pairs = zip(parts_of(logits), parts_of(executed), strict=True)
        return torch.stack([action_cross_entropy(each[..., None, :], own[..., None, :]) for each, own in pairs]).mean(0)

    def distribution(self, logits: Tensor) -> Tensor:
        """Returns distributions; see `ActionHead`."""
        return torch.cat([each.softmax(dim=-1) for each in parts_of(logits)], dim=-1)

    def act(self, context: Tensor, draws: Tensor | None, *, temperature: float) -> Tensor:
        """Returns actions, float32 (B, 4); see `ActionHead`."""
        location_draw, direction_draw, length_draw = [None] * 3 if draws is None else draws.unbind(dim=1)
        found = self.locations(context)
        cell = choose(found.logits, location_draw, temperature=temperature)
        location = functional.one_hot(cell, LOCATIONS).to(context.dtype)
        direction_logits, _ = self._direction_and_length(found, location, context.new_zeros(len(context), DIRECTIONS))
        direction = choose(direction_logits, direction_draw, temperature=temperature)
        is_direction = functional.one_hot(direction, DIRECTIONS).to(context.dtype)
        _, length_logits = self._direction_and_length(found, location, is_direction)
        lengths = torch.linspace(0, 1, LENGTHS, device=context.device)
        if length_draw is None:
            length = length_logits.softmax(dim=1) @ lengths
        else:
            length = lengths[choose(length_logits, length_draw, temperature=temperature)]
        return decode(places_around(found.logits, cell), direction, length)

    def _direction_and_length(self, found: Locations, location: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the logits of directions and lengths, given distributions of locations and directions."""
        place = (location[:, None] @ found.features)[:, 0]  # (B, P)
        inputs = torch.cat([found.hidden, place], dim=1)
        return self.direction(inputs), self.length(torch.cat([inputs, direction], dim=1))


def parts_of(action: Tensor) -> tuple[Tensor, ...]:
    """Returns the location, direction and length of logits or distributions, float32 (..., D)."""
    parts: tuple[Tensor, ...] = torch.split(action, list(PARTS), dim=-1)
    return parts


def perceptron(inputs: int, outputs: int) -> nn.Sequential:
    """Returns two hidden layers with ReLU, and a linear output layer: float32 (..., inputs) to (..., outputs)."""
    return nn.Sequential(
        *(nn.Linear(inputs, _UNITS), nn.ReLU(), nn.Linear(_UNITS, _UNITS), nn.ReLU(), nn.Linear(_UNITS, outputs))
    )
