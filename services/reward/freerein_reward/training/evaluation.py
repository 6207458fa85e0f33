"""Calibration and evaluation of the grounding model on validation images."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from freerein_reward.model import DualEncoder, contrast_texts
from freerein_reward.training import synthetic_objects

if TYPE_CHECKING:
    from freerein_reward.training.grounding_learner import GroundingLearner

_COLOURS_PER_QUERY = 4
_QUERIES = 10
_THRESHOLDS = 200


def calibrate_presence(network: DualEncoder, learner: "GroundingLearner") -> None:
    """Sets `presence_heat` to the threshold with the best balanced accuracy on validation images.

    Each image is queried for a few colours at a time, as in a request.
    """
    heat = threshold_of_presence(*_peaks(network, learner))
    network.spec = replace(network.spec, presence_heat=heat)


def threshold_of_presence(peaks: npt.NDArray[np.float32], is_shown: npt.NDArray[np.bool_]) -> float:
    """Returns the heat that best tells peaks (N,) of what is shown, bool (N,), from others, by balanced accuracy."""
    thresholds = np.quantile(peaks, np.linspace(0, 1, _THRESHOLDS))
    scores = [(peaks[is_shown] > level).mean() + (peaks[~is_shown] <= level).mean() for level in thresholds]
    return float(max(thresholds[int(np.argmax(scores))], 1e-6))


def evaluate_grounding(network: DualEncoder, learner: "GroundingLearner") -> dict[str, float]:
    """Returns accuracies on validation images: of colours, of shapes, and balanced of presence."""
    peaks, is_shown = _peaks(network, learner)
    predictions = peaks > network.spec.presence_heat
    return {
        "colour_accuracy": _accuracy(network, learner, synthetic_objects.COLOURS, "colour"),
        "shape_accuracy": _accuracy(network, learner, synthetic_objects.SHAPES, "shape"),
        "presence_accuracy": float((predictions[is_shown].mean() + 1 - predictions[~is_shown].mean()) / 2),
    }


@torch.no_grad()
def _peaks(network: DualEncoder, learner: "GroundingLearner") -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Returns the peak of each query's heat and whether its colour is shown, each (queries * N * colours,)."""
    rng = np.random.default_rng(learner.config.seed)
    images = learner.validation.images[:, 0]
    cells = network.image.attention_pool.cell_embeddings(network.image.feature_maps(images))  # (N, S, D)
    peaks, is_shown = [], []
    for _ in range(_QUERIES):
        order = rng.permutation(len(synthetic_objects.COLOURS))[:_COLOURS_PER_QUERY]
        colours = [synthetic_objects.COLOURS[index] for index in order]
        heat = cells @ contrast_texts(_embed(network, [f"a {colour} thing" for colour in colours])).T  # (N, S, colours)
        winning = heat.where(heat == heat.amax(dim=2, keepdim=True), 0.0)
        peaks.append(winning.amax(dim=1).cpu().numpy())
        objects = learner.validation.objects
        is_shown.append([[each is not None and each.colour == colour for colour in colours] for each in objects])
    return np.concatenate(peaks).ravel(), np.array(is_shown).ravel()


@torch.no_grad()
def _accuracy(network: DualEncoder, learner: "GroundingLearner", names: Sequence[str], attribute: str) -> float:
    """Returns the zero-shot accuracy of an attribute on validation images that show an object."""
    texts = _embed(network, [f"a {name} thing" if attribute == "colour" else f"a {name}" for name in names])
    predictions = (network.embed_images(learner.validation.images) @ texts.T).argmax(dim=1).tolist()
    pairs = zip(predictions, learner.validation.objects, strict=True)
    return float(np.mean([names[best] == getattr(shown, attribute) for best, shown in pairs if shown]))


def _embed(network: DualEncoder, texts: Sequence[str]) -> torch.Tensor:
    return network.embed_texts(network.tokenize(texts))
