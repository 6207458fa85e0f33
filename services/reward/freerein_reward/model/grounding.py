"""Where a noun phrase is in an image: Grad-CAM on the image tower's last convolution (section 4.2).

The channel weights are the spatial mean of d cos / d A, with the attention and the embedding's length held fixed. The
shares of attention add up to one, so that this mean is the same for every image: what the values make of a channel, in
the text's direction. The weighted sum over the channels of a cell is then what that cell says in that direction, and
no gradient is ever computed. Were the attention not held fixed, the weights would tell how to look elsewhere.

One thing has one name: a phrase is looked for where none of the others that it is asked beside is hotter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein_reward.model.dual_encoder import DualEncoder
from freerein_reward.model.similarity import RewardModel

_IMAGES_AT_ONCE = 64
_STEEPNESS = 5.0
_REACH = 0.1
"""How far from a peak, as a share of the image's side, heat still belongs to it."""

_EDGE = 0.3
"""What share of the peak heat must exceed to pull the place towards it."""


@dataclass(frozen=True, eq=False)
class Grounds:
    """Where P phrases are in N images.

    Attributes:
        heatmaps: float32 (N, P, h, w) in [0, 1]: Grad-CAM, as a share of its peak.
        x: float64 (N, P), from the left edge, as a share of the width.
        y: float64 (N, P), from the upper edge, as a share of the height.
        presence: float64 (N, P) in [0, 1]: how sure the model is that the image shows it at all.
    """

    heatmaps: npt.NDArray[np.float32]
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    presence: npt.NDArray[np.float64]


class GroundingModel(RewardModel):
    """Finds things that are named. The network's device is where it computes; arrays are on the CPU.

    As a reward model it is the base one: it has learnt of things, not of how they lie to one another (section 4.2).

    Args:
        network: Trained on single objects, its `presence_at` calibrated.
    """

    def __init__(self, network: DualEncoder) -> None:
        super().__init__(network)
        self.network = network

    @torch.inference_mode()
    def ground(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> Grounds:
        """Returns where phrases, at least one, are in images uint8 (N, side, side, 3).

        Each phrase is told from the others, and a phrase that comes alone from nothing at all.
        """
        channels = self.weigh(phrases)
        found = []
        for start in range(0, len(images), _IMAGES_AT_ONCE):
            part = torch.tensor(
                images[start : start + _IMAGES_AT_ONCE], device=self._device
            )  # what is mapped is read-only
            found.append(self._look(part, channels))
        heatmaps, places, presence = (torch.cat(each).cpu() for each in zip(*found, strict=True))
        x, y = places.double().unbind(dim=2)
        return Grounds(heatmaps.numpy(), x.numpy(), y.numpy(), presence.double().numpy())

    @torch.no_grad()
    def weigh(self, phrases: Sequence[str]) -> Tensor:
        """Returns what Grad-CAM multiplies each channel of the last map by, for each phrase: float32 (P, C)."""
        ids = torch.from_numpy(self.network.tokenizer(phrases).ids).to(self._device)
        pool = self.network.image.attention
        weights: Tensor = contrast(self.network.embed_texts(ids)) @ pool.out.weight @ pool.value.weight
        return weights

    def _look(self, images: Tensor, channels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns heatmaps (N, P, h, w), places (N, P, 2) and presence (N, P) of images (N, side, side, 3)."""
        maps = self.network.image.maps(images)
        heat = torch.einsum("pc,nchw->nphw", channels, maps).relu()
        own = heat.where(heat == heat.amax(dim=1, keepdim=True), 0.0)  # one thing has one name
        presence = torch.sigmoid(_STEEPNESS * (own.amax(dim=(2, 3)) / self.network.spec.presence_at - 1.0))
        return heat / heat.amax(dim=(2, 3), keepdim=True).clamp(min=1e-6), _places(own), presence


def contrast(texts: Tensor) -> Tensor:
    """Returns each text's embedding less the mean of the others', (P, D) of (P, D)."""
    others = (texts.sum(dim=0) - texts) / max(1, len(texts) - 1)
    return texts - others


def _places(heat: Tensor) -> Tensor:
    """Returns the centroid of the peak of each heatmap (N, P, h, w) as shares of width and height: (N, P, 2)."""
    fine = functional.interpolate(heat, scale_factor=4, mode="bilinear", align_corners=False)  # (N, P, 4 h, 4 w)
    peaks, at = fine.flatten(start_dim=2).max(dim=2)  # (N, P)
    height, width = fine.shape[2:]
    rows = (torch.arange(height, device=heat.device) + 0.5) / height
    columns = (torch.arange(width, device=heat.device) + 0.5) / width
    near_rows = (rows - rows[at // width][..., None]).abs() <= _REACH  # (N, P, 4 h)
    near_columns = (columns - columns[at % width][..., None]).abs() <= _REACH
    core = (fine - _EDGE * peaks[..., None, None]).relu() + 1e-12
    core = core * near_rows[..., :, None] * near_columns[..., None, :]
    share = core / core.sum(dim=(2, 3), keepdim=True)
    return torch.stack([(share.sum(dim=2) * columns).sum(dim=2), (share.sum(dim=3) * rows).sum(dim=2)], dim=2)
