"""Calibration and evaluation of the grounding model's score of phrases, on synthetic images beyond those of the fit."""

from copy import deepcopy
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from freerein.metrics import auroc
from freerein_reward.model import KNOWN, NULL_TEXTS, REFERENCES, DualEncoder, GradCamModel, KnownPhrases
from freerein_reward.training import synthetic_objects

if TYPE_CHECKING:
    from freerein_reward.training.grounding_learner import GroundingLearner

_IMAGES_AT_ONCE = 128
_TEXTS_AT_ONCE = 20
_LONGEST = 3
"""Words without meaning in a text, at most."""

_ARTICLES = ("a", "the", "this", "one")
_SIZES = ("", "small ", "big ")


@torch.no_grad()
def calibrate_known_phrases(network: DualEncoder, learner: "GroundingLearner") -> None:
    """Fits the network's score of phrases, on images that neither training nor validation has seen."""
    config = learner.config
    first = config.train_images + config.validation_images
    items = range(first, first + REFERENCES)
    rendered = [synthetic_objects.render(np.random.default_rng((config.seed, item))) for item in items]
    named = [synthetic_objects.names(shown) for _, shown in rendered]
    shown = torch.tensor([[word in names for word in network.spec.vocabulary] for names in named])
    images = torch.from_numpy(np.stack([image for image, _ in rendered])[:, None]).to(network.device)
    embeddings = torch.cat([network.embed_images(part) for part in torch.split(images, _IMAGES_AT_ONCE)])
    generator = torch.Generator().manual_seed(config.seed)
    score_of(network).fit(embeddings, shown.to(network.device), null_texts(network, generator=generator))


def evaluate_known_phrases(network: DualEncoder, learner: "GroundingLearner") -> dict[str, float]:
    """Returns the AUROC of the score for noun phrases that name a colour among words without meaning, and rates.

    No phrase was used in the calibration, and the words without meaning are others. `known_auroc` is of the score
    alone: looking words up in the vocabulary would separate all of them.
    """
    generator = torch.Generator().manual_seed(learner.config.seed + 1)
    score, model = score_of(network), GradCamModel(network)
    null = score.rank(score.best_auroc(null_texts(network, generator=generator))).cpu().numpy()
    phrases = _noun_phrases()
    coloured, shaped = (model.known(each) for each in phrases)
    scores, labels = np.concatenate([coloured, null]), np.arange(len(coloured) + len(null)) < len(coloured)
    return {
        "known_auroc": auroc(scores, labels),
        "known_colours": float((coloured >= KNOWN).mean()),
        "known_shapes": float((shaped >= KNOWN).mean()),
        "known_nonsense": float((null >= KNOWN).mean()),
    }


def score_of(network: DualEncoder) -> KnownPhrases:
    """Returns the network's score of phrases; a TypeError without."""
    if network.known_phrases is None:
        raise TypeError("This network has no score of phrases; expected a grounding model.")
    return network.known_phrases


@torch.no_grad()
def null_texts(network: DualEncoder, *, generator: torch.Generator) -> Tensor:
    """Returns the embeddings of texts of words without meaning, one to three, float32 (`NULL_TEXTS`, D).

    Such a word is an embedding that is drawn like those of the vocabulary.
    """
    vocabulary, weight = network.spec.vocabulary, network.text.token_embedding.weight
    learned = weight[-len(vocabulary) :].cpu()  # (W, C)
    drawn, embeddings = deepcopy(network.text), []
    for _ in range(NULL_TEXTS // _TEXTS_AT_ONCE):
        imagined = torch.randn(learned.shape, generator=generator) * learned.std(dim=0) + learned.mean(dim=0)
        drawn.token_embedding.weight[-len(vocabulary) :] = imagined.to(weight.device)
        lengths = torch.randint(1, _LONGEST + 1, (_TEXTS_AT_ONCE,), generator=generator).tolist()
        places = [torch.randint(len(vocabulary), (length,), generator=generator).tolist() for length in lengths]
        texts = [" ".join(vocabulary[place] for place in each) for each in places]
        embeddings.append(torch.nn.functional.normalize(drawn(network.tokenize(texts)), dim=1))
    return torch.cat(embeddings)


def _noun_phrases() -> tuple[list[str], list[str]]:
    """Returns noun phrases that name a colour, and some that name a shape alone."""
    nouns = [name for shape in synthetic_objects.SHAPES for name in synthetic_objects.NAMES[shape]]
    colours = product(_ARTICLES, _SIZES, synthetic_objects.COLOURS, (*nouns, "thing", "one", "object"))
    coloured = [f"{article} {size}{colour} {noun}" for article, size, colour, noun in colours]
    return coloured, [f"{article} {size}{noun}" for article, size, noun in product(_ARTICLES, _SIZES, nouns)]
