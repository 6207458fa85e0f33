"""Labels of captions of images, by the criteria of table 4.1 on the keypoints of nouns."""

from collections.abc import Iterable
from itertools import permutations

import numpy as np
import numpy.typing as npt

from freerein.criteria import CRITERIA, Criterion, View
from freerein.criterion_text import Claim
from freerein_reward.methods.criterion_captions.network import MAX_NOUNS, STATEMENTS

SHOWN, HIDDEN, UNSURE = 1, 0, -1
"""Whether a camera shows a phrase."""

TRUE, FALSE, UNKNOWN = 1, 0, -1
"""Labels of captions."""

NO_NOUN = -1
"""Instead of the third phrase of a pair."""

_MOST = 32
"""Pairs, and triples, whose captions are scored at once: 16 phrases have 240 and 3 360."""

Labels = npt.NDArray[np.int8]


def phrase_tuples(count: int) -> npt.NDArray[np.int64]:
    """Returns every ordered pair of `count` phrases, then every ordered triple, int64 (T, `MAX_NOUNS`)."""
    pairs = [(*pair, NO_NOUN) for pair in permutations(range(count), MAX_NOUNS - 1)]
    triples = permutations(range(count), MAX_NOUNS)
    return np.array([*pairs, *triples], np.int64).reshape(-1, MAX_NOUNS)


def sampled_tuples(count: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Returns at most `_MOST` pairs and as many triples of `phrase_tuples`, in their order, int64 (T, `MAX_NOUNS`)."""
    tuples = phrase_tuples(count)
    is_pair = tuples[:, -1] == NO_NOUN
    kinds = (tuples[is_pair], tuples[~is_pair])
    return np.concatenate([each[np.sort(rng.permutation(len(each))[:_MOST])] for each in kinds])


def possible_captions(tuples: npt.NDArray[np.int64], views: Iterable[View]) -> npt.NDArray[np.bool_]:
    """Returns which statements captions of tuples, int64 (T, `MAX_NOUNS`), can make, bool (T, statements)."""
    sizes, seen = np.where(tuples[:, -1] == NO_NOUN, MAX_NOUNS - 1, MAX_NOUNS), set(views)
    possible = [
        sizes == CRITERIA[name].nouns if name and CRITERIA[name].view in seen else np.full(len(tuples), not name)
        for _, name in STATEMENTS
    ]
    return np.stack(possible, axis=1)


def label_captions(
    keypoints: npt.NDArray[np.floating],
    shown: Labels,
    tuples: npt.NDArray[np.int64],
    *,
    criteria: Iterable[Criterion],
    views: Iterable[View],
    tolerance: float,
) -> Labels:
    """Returns whether captions hold of images, int8 (N, T, statements): `TRUE`, `FALSE` or `UNKNOWN`.

    Where a view does not show a noun, no criterion of this view holds. That it fails is only true of nouns that are
    shown. What no view shows is missing.

    Args:
        keypoints: float (N, views, P, 2), x and y in object widths, in the order of `View`.
        shown: int8 (N, views, P), `SHOWN`, `HIDDEN` or `UNSURE`; `UNSURE` everywhere in views that there are not.
        tuples: Numbers of the phrases, int64 (T, `MAX_NOUNS`), as `phrase_tuples`.
        criteria: What captions say.
        views: The views that there are.
        tolerance: Least margin of a sure answer, in object widths.
    """
    labels = np.full((len(keypoints), len(tuples), len(STATEMENTS)), UNKNOWN, np.int8)
    sizes = np.where(tuples[:, -1] == NO_NOUN, MAX_NOUNS - 1, MAX_NOUNS)
    seen = list(views)
    is_gone = (shown[:, seen] == HIDDEN).all(axis=1)  # (N, P)
    is_there = (shown[:, seen] == SHOWN).any(axis=1)
    for size in np.unique(sizes).tolist():
        of_size = np.flatnonzero(sizes == size)
        nouns = tuples[of_size, :size]  # (t, size)
        any_gone, all_there = is_gone[:, nouns].any(axis=2), is_there[:, nouns].all(axis=2)  # (N, t)
        labels[:, of_size, STATEMENTS.index((Claim.MISSING, ""))] = _decided(any_gone, all_there)
        for criterion in (each for each in criteria if each.nouns == size and each.view in seen):
            holds, fails = _judge(criterion, keypoints[:, criterion.view], shown[:, criterion.view], nouns, tolerance)
            is_hidden = (shown[:, criterion.view][:, nouns] == HIDDEN).any(axis=2)
            labels[:, of_size, STATEMENTS.index((Claim.HOLDS, criterion.name))] = _decided(holds, fails | is_hidden)
            labels[:, of_size, STATEMENTS.index((Claim.FAILS, criterion.name))] = _decided(fails, holds | any_gone)
    return labels


def _judge(
    criterion: Criterion,
    keypoints: npt.NDArray[np.floating],
    shown: Labels,
    nouns: npt.NDArray[np.int64],
    tolerance: float,
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Returns where a criterion surely holds, and surely fails, of nouns (t, size): bool (N, t) each."""
    margin = criterion.margin(keypoints[:, nouns])
    are_shown = (shown[:, nouns] == SHOWN).all(axis=2)
    return are_shown & (margin > tolerance), are_shown & (margin < -tolerance)


def _decided(is_true: npt.NDArray[np.bool_], is_false: npt.NDArray[np.bool_]) -> Labels:
    return np.where(is_true, TRUE, np.where(is_false, FALSE, UNKNOWN)).astype(np.int8)
