"""Classes of wordings of goal texts, and the reward for them in nominal scenes, as the service computes it."""

from collections.abc import Callable, Iterator, Mapping
from itertools import permutations
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from experiments.robustness.draw import open_or_draw
from experiments.robustness.reward_model import COLOURS
from experiments.robustness.scenes import nominal_specs, true_relations
from experiments.robustness.worlds import CAMERA
from experiments.workbench.results import Outcome, Sample
from freerein.goal_text import GoalText
from freerein.relations import CANONICAL_WORDINGS, SpatialRelation
from freerein_reward.model import DualEncoderModel, ImageEmbeddings

RECALL, FALSE_RATE = "recall", "false_rate"

Flags = npt.NDArray[np.bool_]
Wording = Callable[[str, SpatialRelation, str], tuple[str, ...]]
"""Returns texts that say that a block of one colour is in a relation to a block of another."""

_CONVERSE = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: ("to the right of", "on the right side of"),
        SpatialRelation.RIGHT_OF: ("to the left of", "on the left side of"),
        SpatialRelation.ON_TOP_OF: ("under", "underneath"),
        SpatialRelation.BELOW: ("on", "above"),
        SpatialRelation.APART_FROM: ("apart from", "far away from"),
    }
)
_OTHER_RELATIONS = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: ("on the left of", "beside, on the left of", "next to and left of"),
        SpatialRelation.RIGHT_OF: ("on the right of", "beside, on the right of", "next to and right of"),
        SpatialRelation.ON_TOP_OF: ("on", "directly above", "stacked on"),
        SpatialRelation.BELOW: ("under", "directly beneath", "at the bottom of"),
        SpatialRelation.APART_FROM: ("far from", "away from", "not near"),
    }
)
_COLOUR_SYNONYMS = MappingProxyType(
    {
        "red": ("crimson", "scarlet"),
        "green": ("emerald", "lime"),
        "yellow": ("golden", "amber"),
        "blue": ("azure", "navy"),
    }
)


def _trained(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    return (f"a {first} block {CANONICAL_WORDINGS[relation]} a {second} block",)


def _converse(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    return tuple(f"a {second} block {words} a {first} block" for words in _CONVERSE[relation])


def _phrases(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    words = CANONICAL_WORDINGS[relation]
    patterns = ("the {0} block {2} the {1} block", "a {0} cube {2} a {1} cube", "the {0} one {2} the {1} one")
    return tuple(pattern.format(first, second, words) for pattern in patterns)


def _punctuation(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    (plain,) = _trained(first, relation, second)
    return (f"{plain}.", plain.upper(), f"{plain.capitalize()}!", plain.replace(" a ", ", a "))


def _imperative(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    words = CANONICAL_WORDINGS[relation]
    return (
        f"put a {first} block {words} a {second} block",
        f"Please put the {first} block {words} the {second} block.",
        f"move the {first} block {words} the {second} block",
    )


def _relations(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    return tuple(f"a {first} block {words} a {second} block" for words in _OTHER_RELATIONS[relation])


def _colours(first: str, relation: SpatialRelation, second: str) -> tuple[str, ...]:
    words = CANONICAL_WORDINGS[relation]
    pairs = zip(_COLOUR_SYNONYMS[first], _COLOUR_SYNONYMS[second], strict=True)
    return tuple(f"a {one} block {words} a {other} block" for one, other in pairs)


CLASSES: Mapping[str, Wording] = MappingProxyType(
    {
        "trained": _trained,
        "converse": _converse,
        "article, cube, one": _phrases,
        "capitals, punctuation": _punctuation,
        "imperative": _imperative,
        "other relations": _relations,
        "synonyms of colours": _colours,
    }
)
"""Wordings by class."""

REFUSABLE = ("other relations", "synonyms of colours")
"""Classes in which it is right, too, to name an unknown word and to give no reward."""


def evaluate(model: DualEncoderModel, work: Path) -> Outcome:
    """Returns recall and false rate of the binary reward by class of wordings; a trial is an episode of two scenes."""
    drawn = [open_or_draw(spec, work) for spec in nominal_specs()]
    truth = np.concatenate([true_relations(each.truth["states"]) for each in drawn])  # (M, P)
    seen = model.embed_images({CAMERA: np.concatenate([each.seen["frames"] for each in drawn])})
    lengths = np.concatenate([each.seen["lengths"] for each in drawn])
    starts = np.cumsum(lengths) - lengths
    samples = {}
    for name, wording in CLASSES.items():
        tally = np.zeros((4, len(truth)))
        for goal, holds in _goals(model, truth, wording):
            is_rewarded = rewards(model, seen, goal)
            is_right = is_rewarded | bool(goal.unknown and name in REFUSABLE)
            tally += np.stack([is_right & holds, holds, is_rewarded & ~holds, ~holds])
        right, true, wrong, false = np.add.reduceat(tally, starts, axis=1).tolist()
        samples[f"{name}.{RECALL}"] = Sample(right, true)
        samples[f"{name}.{FALSE_RATE}"] = Sample(wrong, false)
    return Outcome({}, samples)


def rewards(model: DualEncoderModel, seen: ImageEmbeddings, goal: GoalText) -> Flags:
    """Returns the binary reward of frames, bool (M,), for a goal text.

    A text without a relation has no rivals: the service asks for some, and there is no reward.
    """
    if goal.unknown or not goal.rivals:
        return np.zeros(len(seen.vectors), np.bool_)
    texts, _ = model.embed_texts((goal.text, *goal.rivals))
    similarities = seen.vectors @ texts.T  # (M, K)
    return np.asarray(similarities[:, 0] > similarities[:, 1:].max(axis=1))


def _goals(model: DualEncoderModel, truth: npt.NDArray[np.int64], wording: Wording) -> Iterator[tuple[GoalText, Flags]]:
    """Yields each text as the model's grammar reads it, and whether it holds, bool (M,)."""
    for pair, (first, second) in enumerate(permutations(COLOURS, 2)):
        for relation in SpatialRelation:
            for text in wording(first, relation, second):
                yield model.grammar.read(text), truth[:, pair] == relation
