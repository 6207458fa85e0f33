"""Phrase grounding: Grad-CAM on the image encoder's last convolution (section 4.2).

The channel weights are the spatial mean of d cos / d A with attention weights and embedding norm held fixed. Attention
weights sum to one, so that this mean does not depend on the image: it is the value projection of each channel in the
text's direction, and needs no backward pass. (Without fixed attention the gradient would mostly move the attention.)

Phrases compete: each is located only where its heat exceeds that of all other phrases. Where a request is answered, the
names that the model knows and no phrase says compete, too: without them, what is asked for alone is found in whatever
stands out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from freerein.goal_text import words
from freerein_reward.model.dual_encoder_model import DualEncoderModel
from freerein_reward.model.known_phrases import KNOWN

_IMAGES_AT_ONCE = 64
_STEEPNESS = 5.0
_LEAST_ODDS = 1e-6
_PEAK_RADIUS = 0.1
"""Half-width of the window around a peak, as a fraction of the image."""

_PEAK_FLOOR = 0.3
"""Fraction of the peak below which heat does not count for the centroid."""


@dataclass(frozen=True, eq=False)
class PhraseLocations:
    """Locations of P phrases in N images.

    Attributes:
        heatmaps: float32 (N, P, h, w) in [0, 1], Grad-CAM divided by its peak.
        x: float64 (N, P), distance from the left edge as a fraction of the width.
        y: float64 (N, P), distance from the upper edge as a fraction of the height.
        heat: float64 (N, P), peak of the heat where the phrase's exceeds all others', in units of the heat at which
            presence is 1/2.
        known: float32 (P,), score of `KnownPhrases`; below `KNOWN`, the model does not know what the phrase names.
    """

    heatmaps: npt.NDArray[np.float32]
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    heat: npt.NDArray[np.float64]
    known: npt.NDArray[np.float32]

    @property
    def presence(self) -> npt.NDArray[np.float64]:
        """Probability that the image shows the phrase, float64 (N, P) in [0, 1]; 0 for an unknown phrase."""
        probability = 1 / (1 + np.exp(-_STEEPNESS * (self.heat - 1.0)))
        return np.where(self.known >= KNOWN, probability, 0.0)


def heat_of_presence(presence: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the heat of `PhraseLocations` whose presence is given, of any shape."""
    odds = presence.clip(_LEAST_ODDS, 1 - _LEAST_ODDS)
    heat: npt.NDArray[np.float64] = 1.0 + np.log(odds / (1 - odds)) / _STEEPNESS
    return heat


class GradCamModel(DualEncoderModel):
    """Locates phrases with a network trained on single objects.

    As a reward model it is the base model of section 4.2, which has not learned relations.
    """

    def locate(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> PhraseLocations:
        """Returns the locations of one or more phrases in images uint8 (N, H, W, 3) of the network's size.

        Names that no phrase says compete. Phrases that the model does not know have no heat, and lie in the middle.
        """
        known = self.known(phrases)
        asked = np.flatnonzero(known >= KNOWN)
        competing = [phrases[index] for index in asked.tolist()]
        found = self.ground(images, (*competing, *self._unsaid(competing)) or phrases)
        shape = (len(images), len(phrases))
        heatmaps, heat = np.zeros((*shape, *found.heatmaps.shape[2:]), np.float32), np.zeros(shape)
        x, y = np.full(shape, 0.5), np.full(shape, 0.5)
        for all_phrases, some in ((heatmaps, found.heatmaps), (heat, found.heat), (x, found.x), (y, found.y)):
            all_phrases[:, asked] = some[:, : len(asked)]
        return PhraseLocations(heatmaps, x, y, heat, known)

    @torch.inference_mode()
    def known(self, phrases: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns how well the model knows each phrase, float32 (P,) in [0, 1]; 0 with a word that it does not know."""
        score = self.network.known_phrases
        if score is None:
            raise TypeError("This network has no score of phrases; expected a grounding model.")
        scores = score(phrases, self.network.embed_texts(self.network.tokenize(phrases))).cpu().numpy()
        is_readable = [not self.grammar.unknown_words((phrase,)) for phrase in phrases]
        return np.where(is_readable, scores, 0).astype(np.float32)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The words of the vocabulary by which the model knows things, such as colours."""
        score = self.network.known_phrases
        candidates = score.names() if score is not None else ()
        known = self.known([_named(word) for word in candidates]) if candidates else ()
        return tuple(word for word, score in zip(candidates, known, strict=True) if score >= KNOWN)

    def _unsaid(self, phrases: Sequence[str]) -> list[str]:
        said = {word for phrase in phrases for word in words(phrase)}
        return [_named(word) for word in self.names if word not in said]

    @torch.inference_mode()
    def ground(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> PhraseLocations:
        """Returns the locations of one or more phrases, as they are, in images uint8 (N, H, W, 3).

        Only the phrases given compete, and whether the model knows them is not asked.
        """
        channels = self.channel_weights(phrases)
        parts = []
        for start in range(0, len(images), _IMAGES_AT_ONCE):
            part = torch.tensor(images[start : start + _IMAGES_AT_ONCE], device=self.network.device)  # may be read-only
            parts.append(self._locate(part, channels))
        heatmaps, centroids, peaks = (torch.cat(each).cpu() for each in zip(*parts, strict=True))
        x, y = centroids.double().unbind(dim=2)
        known = np.ones(len(phrases), np.float32)
        return PhraseLocations(heatmaps.numpy(), x.numpy(), y.numpy(), peaks.double().numpy(), known)

    @torch.no_grad()
    def channel_weights(self, phrases: Sequence[str]) -> Tensor:
        """Returns Grad-CAM's channel weights for each phrase, float32 (P, C)."""
        texts = self.network.embed_texts(self.network.tokenize(phrases))
        pool = self.network.image.attention_pool
        weights: Tensor = contrast_texts(texts) @ pool.out.weight @ pool.value.weight
        return weights

    def _locate(self, images: Tensor, channels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns heatmaps (N, P, h, w), centroids (N, P, 2) and peaks (N, P) of images (N, H, W, 3)."""
        maps = self.network.image.feature_maps(images)
        heat = torch.einsum("pc,nchw->nphw", channels, maps).relu()
        own = heat.where(heat == heat.amax(dim=1, keepdim=True), 0.0)  # phrases compete
        peaks = own.amax(dim=(2, 3)) / self.network.spec.presence_heat
        return heat / heat.amax(dim=(2, 3), keepdim=True).clamp(min=1e-6), _centroids(own), peaks


def _named(word: str) -> str:
    return f"a {word} thing"


def contrast_texts(texts: Tensor) -> Tensor:
    """Returns each text embedding minus the mean of the others, (P, D) of (P, D)."""
    others = (texts.sum(dim=0) - texts) / max(1, len(texts) - 1)
    return texts - others


def _centroids(heat: Tensor) -> Tensor:
    """Returns the centroid of each heatmap's peak (N, P, h, w) as fractions of width and height: (N, P, 2)."""
    fine = functional.interpolate(heat, scale_factor=4, mode="bilinear", align_corners=False)  # (N, P, 4 h, 4 w)
    peaks, at = fine.flatten(start_dim=2).max(dim=2)  # (N, P)
    height, width = fine.shape[2:]
    rows = (torch.arange(height, device=heat.device) + 0.5) / height
    columns = (torch.arange(width, device=heat.device) + 0.5) / width
    near_rows = (rows - rows[at // width][..., None]).abs() <= _PEAK_RADIUS  # (N, P, 4 h)
    near_columns = (columns - columns[at % width][..., None]).abs() <= _PEAK_RADIUS
    core = (fine - _PEAK_FLOOR * peaks[..., None, None]).relu() + 1e-12
    core = core * near_rows[..., :, None] * near_columns[..., None, :]
    share = core / core.sum(dim=(2, 3), keepdim=True)
    return torch.stack([(share.sum(dim=2) * columns).sum(dim=2), (share.sum(dim=3) * rows).sum(dim=2)], dim=2)
