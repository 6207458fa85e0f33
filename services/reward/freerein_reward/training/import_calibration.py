"""Calibration of a model that was trained elsewhere, on the synthetic images of single objects.

Nothing of the model is trained: they say from which heat a thing counts as present, and which phrases the model tells.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein_reward.model import KNOWN, NULL_TEXTS, Calibration, KnownPhrases, contrast_texts
from freerein_reward.model.vision_language import VisionLanguageModel, heat_maps
from freerein_reward.training import synthetic_objects
from freerein_reward.training.evaluation import threshold_of_presence

_IMAGES_AT_ONCE = 16
_TEXTS_AT_ONCE = 50
_QUERIES = 4
_COLOURS_PER_QUERY = 4
_PRESENCE_SHARE = 8
"""One image in so many is searched for colours, too, which may need a backward pass each."""

_CONSONANTS, _VOWELS = "bdfgklmnprstvz", "aeiou"


@dataclass(frozen=True, eq=False)
class _Seen:
    """Synthetic images of N moments as a model sees them: pixels, embeddings float32 (N, D), and what they show."""

    images: Tensor
    embeddings: Tensor
    objects: tuple[synthetic_objects.Attributes | None, ...]


@torch.inference_mode()
def calibrate(model: VisionLanguageModel, *, images: int, seed: int) -> tuple[Calibration, dict[str, float]]:
    """Returns the calibration of a model on so many images, and how well it tells what they show."""
    seen = _seen(model, images, seed)
    generator = torch.Generator().manual_seed(seed)
    score = KnownPhrases(synthetic_objects.VOCABULARY, model.dimension, references=images).to(model.device)
    named = [synthetic_objects.names(each) for each in seen.objects]
    shown = torch.tensor([[word in each for word in synthetic_objects.VOCABULARY] for each in named])
    score.fit(seen.embeddings, shown.to(model.device), _embedded(model, null_texts(NULL_TEXTS, generator=generator)))
    peaks, is_shown = _peaks(model, seen, np.random.default_rng(seed))
    heat = threshold_of_presence(peaks, is_shown)
    found = peaks > heat
    colours = [f"a {colour} thing" for colour in synthetic_objects.COLOURS]
    known = score(colours, _embedded(model, colours)).cpu().numpy()
    return Calibration(score, heat), {
        "colour_accuracy": _accuracy(model, seen, synthetic_objects.COLOURS, "colour"),
        "shape_accuracy": _accuracy(model, seen, synthetic_objects.SHAPES, "shape"),
        "presence_accuracy": float((found[is_shown].mean() + 1 - found[~is_shown].mean()) / 2),
        "known_colours": float((known >= KNOWN).mean()),
    }


def null_texts(count: int, *, generator: torch.Generator) -> list[str]:
    """Returns distinct texts of one to three words without meaning: two or three syllables each."""

    def pick(letters: str) -> str:
        return letters[int(torch.randint(len(letters), (), generator=generator))]

    def word() -> str:
        syllables = 2 + int(torch.randint(2, (), generator=generator))
        return "".join(pick(_CONSONANTS) + pick(_VOWELS) for _ in range(syllables))

    texts: dict[str, None] = {}
    while len(texts) < count:
        texts[" ".join(word() for _ in range(1 + int(torch.randint(3, (), generator=generator))))] = None
    return list(texts)


def _seen(model: VisionLanguageModel, count: int, seed: int) -> _Seen:
    rendered = [synthetic_objects.render(np.random.default_rng((seed, item))) for item in range(count)]
    images = torch.from_numpy(np.stack([model.preprocess(image) for image, _ in rendered]))
    parts = [model.embed_images(part.to(model.device)) for part in torch.split(images, _IMAGES_AT_ONCE)]
    return _Seen(images, torch.cat(parts), tuple(shown for _, shown in rendered))


def _embedded(model: VisionLanguageModel, texts: Sequence[str]) -> Tensor:
    parts = (texts[start : start + _TEXTS_AT_ONCE] for start in range(0, len(texts), _TEXTS_AT_ONCE))
    return torch.cat([model.embed_texts(part) for part in parts])


def _peaks(
    model: VisionLanguageModel, seen: _Seen, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Returns the peak of each query's heat, and whether its colour is shown, each (queries * N * colours,).

    Each image is queried for a few colours at a time, as in a request.
    """
    count = -(-len(seen.images) // _PRESENCE_SHARE)
    peaks, is_shown = [], []
    for _ in range(_QUERIES):
        colours = rng.permutation(synthetic_objects.COLOURS)[:_COLOURS_PER_QUERY].tolist()
        directions = contrast_texts(_embedded(model, [f"a {colour} thing" for colour in colours]))
        for part in torch.split(seen.images[:count], _IMAGES_AT_ONCE):
            heat = heat_maps(model, part.to(model.device), directions)
            winning = heat.where(heat == heat.amax(dim=1, keepdim=True), 0.0)
            peaks.append(winning.amax(dim=(2, 3)).cpu().numpy())
        shown = [each.colour if each else None for each in seen.objects[:count]]
        is_shown.append([[each == colour for colour in colours] for each in shown])
    return np.concatenate(peaks).ravel(), np.concatenate(is_shown).ravel()


def _accuracy(model: VisionLanguageModel, seen: _Seen, names: Sequence[str], attribute: str) -> float:
    """Returns the zero-shot accuracy of an attribute on images that show an object."""
    texts = _embedded(model, [f"a {name} thing" if attribute == "colour" else f"a {name}" for name in names])
    best = (seen.embeddings @ texts.T).argmax(dim=1).tolist()
    pairs = zip(best, seen.objects, strict=True)
    return float(np.mean([names[place] == getattr(shown, attribute) for place, shown in pairs if shown]))
