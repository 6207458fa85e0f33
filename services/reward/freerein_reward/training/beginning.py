"""How the training of a dual encoder begins."""

from collections.abc import Sequence

import torch

from freerein.learning.train_state import TrainState
from freerein_reward.model import DualEncoder, GroundingModel, channels_last

_STEEPNESS = 16.0
_NEARLY = 0.75
"""The share of the heat of a thing that is there at which a head finds it as likely as not."""


def begin(
    network: DualEncoder, highest_rate: float, *, generator: torch.Generator, device: torch.device
) -> TrainState[DualEncoder]:
    """Returns the state before the first update of a network whose weights are drawn; frozen weights stay."""
    channels_last(network.to(device))
    learnt = [parameter for parameter in network.parameters() if parameter.requires_grad]
    return TrainState(network, torch.optim.Adam(learnt, highest_rate, fused=True), generator)


@torch.no_grad()
def adopt(network: DualEncoder, grounding: GroundingModel, phrases: Sequence[str]) -> None:
    """Makes a network that asks for places see as a grounding model does.

    It gets the convolutions with their statistics, frozen: they know colours and shapes, to which relations have
    nothing to add. Its first heads get Grad-CAM's weights, so that before the first update each finds what a phrase
    names.

    Args:
        network: With at least as many heads as there are phrases.
        grounding: Of the same width and depth.
        phrases: What to look for.
    """
    ours, theirs = network.image, grounding.network.image
    for mine, known in ((ours.stem, theirs.stem), (ours.near, theirs.near), (ours.far, theirs.far)):
        mine.load_state_dict(known.state_dict())
        mine.requires_grad_(False)
    network.eval()
    scale = _STEEPNESS / grounding.network.spec.presence_at
    ours.places.ask.weight[: len(phrases)] = scale * grounding.weigh(phrases)
    ours.places.ask.bias[: len(phrases)] = -_NEARLY * _STEEPNESS
