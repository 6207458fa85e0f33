"""Checks of a dataset's captions: those that hardly vary, and models that learned nothing from them."""

from collections.abc import Mapping

import numpy as np

from freerein.relations import CANONICAL_WORDINGS, SpatialRelation
from freerein_reward.methods.relation_captions.caption_dataset import CaptionDataset

_ONE_RELATION = 0.9
"""Share of captions from which one relation makes up nearly all."""


def caption_warnings(images: CaptionDataset) -> list[str]:
    """Returns a warning where one relation makes up nearly all captions, each pair of phrases counted once."""
    pairs = np.triu_indices(len(images.phrases), k=1)
    relations = images.relations[:, *pairs]
    is_one = (relations >= 0) & (relations < len(SpatialRelation))
    counts = np.bincount(relations[is_one], minlength=len(SpatialRelation))
    most, share = SpatialRelation(int(counts.argmax())), counts.max() / max(1, counts.sum())
    if share <= _ONE_RELATION:
        return []
    return [
        f"`{CANONICAL_WORDINGS[most]}` makes up {share:.0%} of the {counts.sum()} captions: the model may have learned "
        "nothing else. Add images in which the objects stand otherwise, and check `epsilon`, the object width."
    ]


def accuracy_warnings(figures: Mapping[str, float]) -> list[str]:
    """Returns a warning where a model tells relations no better than the most frequent one of each pair does."""
    accuracy, majority = figures["relation_accuracy"], figures["majority_accuracy"]
    if accuracy > majority:
        return []
    return [
        f"On held-out images the model tells {accuracy:.0%} of the relations, and always saying the most frequent one "
        f"of each pair {majority:.0%}: it has learned nothing else. Add images, or steps."
    ]
