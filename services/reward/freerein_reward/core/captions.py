"""What can be said of images in which things were found."""

from collections.abc import Sequence
from itertools import permutations

from freerein_reward.model import Grounds
from freerein_reward.relations import Relation, caption
from freerein_reward.training.described import UNSAID, relations_of

_SHOWN = 0.5


def captions(found: Grounds, phrases: Sequence[str], *, epsilon: float) -> list[tuple[str, ...]]:
    """Returns for each image a caption for each ordered pair of phrases that it shows (table 4.1).

    Args:
        found: Where the phrases are.
        phrases: P of them.
        epsilon: A thing's width as a share of the image's.
    """
    relations = relations_of(found.x, found.y, found.presence >= _SHOWN, epsilon=epsilon)  # (N, P, P)
    pairs = tuple(permutations(range(len(phrases)), 2))
    return [
        tuple(
            caption(phrases[first], Relation(told[first, second]), phrases[second])
            for first, second in pairs
            if told[first, second] != UNSAID
        )
        for told in relations
    ]
