"""What captions of a dataset can teach: phrases that no image shows, and captions that hardly vary."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.relations import CANONICAL_WORDINGS, SpatialRelation
from freerein_reward.methods.relation_captions.caption_dataset import CaptionDataset
from freerein_reward.model import GradCamModel

_SAMPLE = 256
"""Images that are searched for a phrase."""

_ONE_RELATION = 0.9
"""Share of captions from which one relation makes up nearly all."""


def check_shown(frames: npt.NDArray[np.uint8], phrases: Sequence[str], grounding: GradCamModel) -> None:
    """Raises InvalidInput where no image shows a phrase: captions would say of other objects that they are it.

    Here, unlike in captioning, phrases compete with all names that the grounding model knows. `frames` are uint8
    (N, H, W, 3), of which a sample is searched.
    """
    sample = np.linspace(0, len(frames) - 1, min(len(frames), _SAMPLE)).round().astype(np.int64)
    presence = grounding.locate(frames[sample], phrases).presence.max(axis=0)  # (P,)
    missing = [phrase for phrase, most in zip(phrases, presence.tolist(), strict=True) if most < 0.5]
    if missing:
        raise InvalidInput(
            f"Images must show every phrase; of {len(sample)}, none shows {', '.join(missing)}.",
            field="config.phrases",
            hint=f"Name objects by the colours that the images show; `Ground` tells {', '.join(grounding.names)}.",
        )


def caption_warnings(images: CaptionDataset) -> list[str]:
    """Returns a warning where one relation makes up nearly all captions, each pair of phrases counted once."""
    pairs = np.triu_indices(len(images.phrases), k=1)
    told = images.relations[:, *pairs]
    counts = np.bincount(told[(told >= 0) & (told < len(SpatialRelation))], minlength=len(SpatialRelation))
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
