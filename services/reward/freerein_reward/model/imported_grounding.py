"""A grounding model around a vision-language model that was trained elsewhere, and its folder.

<folder>/card.json                    `layout` and `place`; figures of the import
         known_phrases.safetensors    what the score of phrases is relative to
         model.safetensors, ...       the model's own files; see `openai_clip` and `transformers_models`
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import InvalidInput, quoted
from freerein.goal_text import GoalText, Grammar, Words
from freerein.learning import tensor_files
from freerein.learning.model_files import choose_device
from freerein_reward.model.dual_encoder_model import ImageEmbeddings
from freerein_reward.model.grounding import PhraseLocator
from freerein_reward.model.known_phrases import KnownPhrases
from freerein_reward.model.vision_language import KEYPOINTS, VisionLanguageModel
from freerein_reward.model.vision_language.openai_clip import load_openai_clip
from freerein_reward.model.vision_language.transformers_models import load_transformers_model

KNOWN_PHRASES = "known_phrases.safetensors"
LAYOUTS: Mapping[str, Callable[[Path, torch.device], VisionLanguageModel]] = MappingProxyType(
    {"openai": load_openai_clip, "transformers": load_transformers_model}
)
"""Loaders of a folder's model, by the card's `layout`."""

_IMAGES_AT_ONCE = 16


@dataclass(frozen=True)
class Calibration:
    """The inputs of grounding beside the model.

    Attributes:
        known_phrases: Scores phrases that name something which its reference images show.
        presence_heat: Heat at which presence is 1/2.
    """

    known_phrases: KnownPhrases
    presence_heat: float


class OpenGrammar(Grammar):
    """The grammar of a model that reads any word."""

    def __init__(self) -> None:
        super().__init__((), ())

    def read(self, text: str) -> GoalText:
        """Returns a text as it is; no word is unknown."""
        return GoalText(text, (), None, ())

    def unknown_words(self, _phrases: Any) -> Words:
        """Returns no words."""
        return ()


class ImportedGrounding(PhraseLocator):
    """Locates phrases with a model that was trained elsewhere; as a reward model it is section 4.2's base model.

    Attributes:
        cameras: One empty name: any image.
        aspects: None: frames of any proportions.
    """

    cameras = ("",)
    aspects: Mapping[str, float] = MappingProxyType({})

    def __init__(self, model: VisionLanguageModel, calibration: Calibration, *, place: str) -> None:
        self.vision_language = model
        self.grammar = OpenGrammar()
        self.place = place
        self._calibration = calibration

    @property
    def presence_heat(self) -> float:
        """Peak of the heat at which an object is present with probability 1/2."""
        return self._calibration.presence_heat

    @property
    def known_phrases(self) -> KnownPhrases:
        """Scores phrases."""
        return self._calibration.known_phrases

    def known(self, phrases: Sequence[str]) -> npt.NDArray[np.float32]:
        """Returns how well the model knows each phrase, float32 (P,) in [0, 1]; 1 where no reference image can tell."""
        is_judged = [self.known_phrases.judges(phrase) for phrase in phrases]
        return np.where(is_judged, super().known(phrases), 1).astype(np.float32)

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns an image uint8 (h, w, 1 or 3), of any size, as the model's input, uint8 (H, W, 3)."""
        return self.vision_language.preprocess(image)

    @torch.inference_mode()
    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        """Returns what the model keeps of images by camera, uint8 (N, H, W, 3); distances are 0."""
        (images,) = views.values()
        device = self.vision_language.device
        parts = [
            self.vision_language.embed_images(part.to(device))
            for part in torch.split(torch.tensor(images), _IMAGES_AT_ONCE)
        ]
        return ImageEmbeddings(torch.cat(parts).cpu().numpy(), np.zeros(len(images), np.float32))

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Returns embeddings, float32 (K, D), and whether each text was truncated, bool (K,)."""
        return self.vision_language.embed_texts(texts).cpu().numpy(), self.vision_language.truncated(texts)

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Returns the products of embeddings of images (N, D) and texts (K, D), float32 (N, K) in [-1, 1]."""
        return (images @ texts.T).clip(-1.0, 1.0)

    def in_distribution(
        self, _distances: npt.NDArray[np.float32], _similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        """Returns float32 (0,): the model has no score."""
        return np.empty(0, np.float32)


def load_imported(folder: Path, card: Mapping[str, Any], device: str) -> ImportedGrounding:
    """Returns the grounding model in a folder.

    Raises:
        InvalidInput: A file is missing or malformed.
        Unimplemented: The model needs a library that is not installed.
    """
    layout, place = str(card.get("layout")), str(card.get("place"))
    heat, vocabulary = card.get("presence_heat"), card.get("vocabulary")
    if (
        layout not in LAYOUTS
        or place not in KEYPOINTS
        or not isinstance(heat, float)
        or not isinstance(vocabulary, list)
    ):
        raise _damaged("card.json", f"layout {layout}, place {place}")
    model = LAYOUTS[layout](folder, choose_device(device))
    try:
        kept = tensor_files.parse((folder / KNOWN_PHRASES).read_bytes())
        score = KnownPhrases(tuple(map(str, vocabulary)), model.dimension, references=len(kept["images"]))
        score.load_state_dict(kept)
    except (OSError, KeyError, RuntimeError) as error:
        raise _damaged(KNOWN_PHRASES, repr(error)) from None
    return ImportedGrounding(model, Calibration(score.to(model.device), heat), place=place)


def _damaged(name: str, got: str) -> InvalidInput:
    return InvalidInput(
        f"An imported model's {name} must be as the import wrote it; got {quoted(got)}.",
        hint="Import the model again, or restore its folder from a copy.",
    )
