"""Evaluation of a reward model on validation images."""

import numpy as np
import numpy.typing as npt

from freerein.relations import SpatialRelation
from freerein_reward.methods.relation_captions.caption_dataset import ABSENT, CaptionDataset, flatten_pairs
from freerein_reward.methods.relation_captions.losses import caption_scores
from freerein_reward.model import DualEncoder
from freerein_reward.model.phrase_relations import NO_CAPTION


def evaluate_reward(network: DualEncoder, dataset: CaptionDataset) -> dict[str, float]:
    """Returns the accuracy of relations against the grounding model's captions, and precision and recall of each.

    `majority_accuracy` is that of always saying the most frequent relation of each ordered pair.

    Captions come from the grounding model, so that this is agreement with it, not ground truth.
    """
    targets = flatten_pairs(dataset.relations)  # (N, pairs)
    has_caption = targets != NO_CAPTION
    targets, predictions = targets[has_caption], caption_scores(network, dataset).argmax(dim=2).numpy()[has_caption]
    figures = {
        "relation_accuracy": float((predictions == targets)[targets != ABSENT].mean()),
        "majority_accuracy": pair_majority_accuracy(flatten_pairs(dataset.relations)),
        "absence_accuracy": float(((predictions == ABSENT) == (targets == ABSENT)).mean()),
    }
    for relation in SpatialRelation:
        true_positives = float(((predictions == relation) & (targets == relation)).sum())
        name = relation.name.lower()
        figures[f"{name}.precision"] = true_positives / max(1, int((predictions == relation).sum()))
        figures[f"{name}.recall"] = true_positives / max(1, int((targets == relation).sum()))
    return figures


def pair_majority_accuracy(relations: npt.NDArray[np.int64]) -> float:
    """Returns the accuracy of always saying the most frequent relation of each ordered pair, of relations (N, pairs).

    A pair and its reverse have mirrored relations, so that one answer for all pairs would be a weak guess.
    """
    counts = (relations[:, :, None] == np.array(SpatialRelation)).sum(axis=0)  # (pairs, relations)
    return float(counts.max(axis=1).sum() / counts.sum())
