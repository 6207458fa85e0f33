"""Phrase grounding: Grad-CAM on the image encoder's last convolution (section 4.2).

The channel weights are the spatial mean of d cos / d A with attention weights and embedding norm held fixed. Attention
weights sum to one, so that this mean does not depend on the image: it is the value projection of each channel in the
text's direction, and needs no backward pass. (Without fixed attention the gradient would mostly move the attention.)

Phrases compete: each is located only where its heat exceeds that of all other phrases. Where a request is answered, the
names that the model knows and no phrase says compete, too: without them, what is asked for alone is found in whatever
stands out.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.goal_text import Grammar, words
from freerein_reward.model.dual_encoder import DualEncoder
from freerein_reward.model.dual_encoder_model import DualEncoderModel
from freerein_reward.model.known_phrases import KNOWN, KnownPhrases
from freerein_reward.model.vision_language import KEYPOINTS, BuiltIn, VisionLanguageModel, heat_maps

_IMAGES_AT_ONCE = 64
_STEEPNESS = 5.0
_LEAST_ODDS = 1e-6


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


class PhraseLocator(ABC):
    """Locates phrases with a vision-language model.

    Attributes:
        grammar: Knows the words that the model was trained on.
        vision_language: The model.
        place: How heat becomes a keypoint, of `KEYPOINTS`.
    """

    grammar: Grammar
    vision_language: VisionLanguageModel
    place = "centroid"

    @property
    @abstractmethod
    def presence_heat(self) -> float:
        """Peak of the heat at which an object is present with probability 1/2."""

    @property
    @abstractmethod
    def known_phrases(self) -> KnownPhrases:
        """Scores phrases."""

    @property
    def image_size(self) -> int:
        """Height and width of the model's input, in pixels."""
        return self.vision_language.image_size

    def locate(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> PhraseLocations:
        """Returns the locations of one or more phrases in images uint8 (N, H, W, 3) of the model's size.

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
        scores = self.known_phrases(phrases, self.vision_language.embed_texts(phrases)).cpu().numpy()
        is_readable = [not self.grammar.unknown_words((phrase,)) for phrase in phrases]
        return np.where(is_readable, scores, 0).astype(np.float32)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The words by which the model knows things, such as colours."""
        candidates = self.known_phrases.names()
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
        directions = contrast_texts(self.vision_language.embed_texts(phrases))
        parts = []
        for start in range(0, len(images), _IMAGES_AT_ONCE):
            part = torch.tensor(images[start : start + _IMAGES_AT_ONCE], device=directions.device)  # may be read-only
            parts.append(self._locate(heat_maps(self.vision_language, part, directions)))
        heatmaps, keypoints, peaks = (torch.cat(each).cpu() for each in zip(*parts, strict=True))
        x, y = keypoints.double().unbind(dim=2)
        known = np.ones(len(phrases), np.float32)
        return PhraseLocations(heatmaps.numpy(), x.numpy(), y.numpy(), peaks.double().numpy(), known)

    def _locate(self, heat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns heatmaps (N, P, h, w), keypoints (N, P, 2) and peaks (N, P) of heat (N, P, h, w)."""
        own = heat.where(heat == heat.amax(dim=1, keepdim=True), 0.0)  # phrases compete
        peaks = own.amax(dim=(2, 3)) / self.presence_heat
        return heat / heat.amax(dim=(2, 3), keepdim=True).clamp(min=1e-6), KEYPOINTS[self.place](own), peaks


class GradCamModel(PhraseLocator, DualEncoderModel):
    """Locates phrases with a dual encoder that was trained on single objects.

    As a reward model it is the base model of section 4.2, which has not learned relations.
    """

    def __init__(self, network: DualEncoder) -> None:
        super().__init__(network)
        self._built_in = BuiltIn(self.network)
        self.vision_language = self._built_in

    @property
    def presence_heat(self) -> float:
        """Peak of the heat at which an object is present with probability 1/2."""
        return self.network.spec.presence_heat

    @property
    def known_phrases(self) -> KnownPhrases:
        """Scores phrases; a TypeError for a reward model's network."""
        if self.network.known_phrases is None:
            raise TypeError("This network has no score of phrases; expected a grounding model.")
        return self.network.known_phrases

    @torch.no_grad()
    def channel_weights(self, phrases: Sequence[str]) -> Tensor:
        """Returns Grad-CAM's channel weights for each phrase, float32 (P, C)."""
        return self._built_in.channel_weights(contrast_texts(self._built_in.embed_texts(phrases)))


def _named(word: str) -> str:
    return f"a {word} thing"


def contrast_texts(texts: Tensor) -> Tensor:
    """Returns each text embedding minus the mean of the others, (P, D) of (P, D)."""
    others = (texts.sum(dim=0) - texts) / max(1, len(texts) - 1)
    return texts - others
