"""The head of pick and place whose location is one of 400 cells, read from the hidden features."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from freerein.learning.encoders import FrameTensors
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.shared.action_heads.pick_and_place import LOCATIONS
from freerein_imitation.methods.shared.action_heads.pick_head import Locations, PickHead, perceptron

_EMBEDDING = 50


class AutoregressiveHead(PickHead):
    """Location, direction and length, each depending on those before, as in the dissertation's rope experiments."""

    code_size = 0

    def __init__(self, hidden: int, _action: ActionSpec, _cameras: Sequence[Camera] = ()) -> None:
        super().__init__(hidden, _EMBEDDING)
        self.location = perceptron(hidden, LOCATIONS)
        self.embedding = nn.Embedding(LOCATIONS, _EMBEDDING)

    def encode(self, frames: FrameTensors) -> Tensor:
        """Returns codes of no numbers; see `ActionHead`."""
        first = next(iter(frames.values()))
        return torch.zeros((len(first), 0), device=first.device)

    def locations(self, context: Tensor) -> Locations:
        """Returns logits of the locations; see `PickHead`."""
        return Locations(context, self.location(context), self.embedding.weight)
