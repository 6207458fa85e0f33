"""Random goal texts whose words are tagged: what a `GoalTextReader` is trained on.

A reader is to learn where a noun phrase begins and ends, and which words relate it to the other, whatever it names and
however it is said. Most objects here need be in no dataset, but `yellow`, `green` and `block` are words of these texts,
and so are the wordings of relations. Of the wordings that test language policies only these are held out: verbs
(`want`, `arrange`, `slide`), the sentences around a statement (`could you`, `so that`), and `cube`.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from freerein_imitation.methods.language.texts.goal_text_reader import Tag

TaggedText = list[tuple[str, Tag]]
"""The words of a text, punctuation included, and the tag of each."""


def _sides(side: str) -> tuple[str, ...]:
    plain = (f"to the {side} of", f"{side} of", f"on the {side} side of", f"to the {side} side of", f"at the {side} of")
    return (*plain, f"{side} side of")


WORDINGS: Mapping[Tag, tuple[str, ...]] = MappingProxyType(
    {
        Tag.LEFT_OF: _sides("left"),
        Tag.RIGHT_OF: _sides("right"),
        Tag.ON_TOP_OF: ("on top of", "on the top of", "on", "onto", "upon", "above", "over", "atop"),
        Tag.BELOW: ("below", "under", "underneath", "beneath"),
        Tag.APART_FROM: ("apart from", "far apart from", "far from", "far away from", "away from"),
    }
)
"""The wordings of each relation, the usual one first."""

ADJECTIVES = (
    *("red", "green", "yellow", "black", "white", "orange", "purple", "brown", "pink", "grey", "silver"),
    *("wooden", "big", "small", "round", "square", "striped", "shiny", "old", "heavy", "dark", "light"),
)
NOUNS = (
    *("block", "ball", "box", "bowl", "cup", "mug", "plate", "bottle", "book", "toy"),
    *("tile", "disc", "tower", "brick", "lamp", "chair", "key", "phone", "spoon", "apple"),
)
_GENERIC_NOUNS = ("one", "object", "thing")
_ARTICLES = ("a", "a", "the", "the", "the", "this", "that", "one", "")
_VERBS = ("put", "place", "push", "set", "bring", "get", "keep")
_COPULAS = (
    *("is", "are", "should be", "must be", "lies", "sits", "rests", "stands", "is placed", "is lying"),
    *("ends up", "belongs", "has to be", "that is"),
)
_ADVERBS = ("just", "directly", "immediately", "somewhere", "slightly", "close by and", "near and")
_OTHER_TEXTS = (
    *("{verb} {phrase}", "{verb} {phrase} away", "look at {phrase}", "find {phrase}", "pick up {phrase}"),
    *("hold {phrase}", "turn {phrase} around", "open the gripper", "close the gripper", "go home", "stop", "wait"),
)

_SAME_NOUN, _OTHER_TEXT, _USUAL_WORDING, _ADVERB, _INVERTED = 0.6, 0.12, 0.2, 0.2, 0.25
_COMMA, _COMMA_WHEN_INVERTED, _PLEASE, _END = 0.07, 0.5, 0.1, 0.2


def draw_tagged_text(rng: np.random.Generator) -> TaggedText:
    """Returns a random text: most often a statement of two noun phrases, else one that relates nothing."""
    adjectives, nouns = rng.choice(ADJECTIVES, 2, replace=False), rng.choice(NOUNS, 2)
    if rng.random() < _SAME_NOUN:
        nouns[1] = nouns[0]
    first, second = (
        _phrase(rng, str(adjective), str(noun), tag)
        for adjective, noun, tag in zip(adjectives, nouns, (Tag.FIRST, Tag.SECOND), strict=True)
    )
    if rng.random() < _OTHER_TEXT:
        phrase = " ".join(word for word, _ in first)
        return _tagged(str(rng.choice(_OTHER_TEXTS)).format(verb=rng.choice(_VERBS), phrase=phrase), Tag.NOTHING)
    return _in_a_sentence(rng, _statement(rng, first, second))


def _statement(rng: np.random.Generator, first: TaggedText, second: TaggedText) -> TaggedText:
    relation = tuple(WORDINGS)[rng.integers(len(WORDINGS))]
    usual, *others = WORDINGS[relation]
    related = _tagged(usual if rng.random() < _USUAL_WORDING else str(rng.choice(others)), relation)
    if rng.random() < _ADVERB:
        related = [*_tagged(str(rng.choice(_ADVERBS)), Tag.NOTHING), *related]
    verb = _tagged(str(rng.choice(_VERBS)), Tag.NOTHING)
    if rng.random() < _INVERTED:
        begin = [*related, *_comma(rng, _COMMA), *second, *_comma(rng, _COMMA_WHEN_INVERTED)]
        return [*begin, *(verb if rng.random() < 0.5 else []), *first]
    before, copula = (
        ([], []),
        (verb, []),
        ([], _tagged(str(rng.choice(_COPULAS)), Tag.NOTHING)),
    )[rng.integers(3)]
    return [*before, *first, *copula, *_comma(rng, _COMMA), *related, *_comma(rng, _COMMA), *second]


def _in_a_sentence(rng: np.random.Generator, statement: TaggedText) -> TaggedText:
    please, end = _tagged("please", Tag.NOTHING), _tagged(str(rng.choice((".", "!", "?"))), Tag.NOTHING)
    before, after, stop = rng.random(3) < (_PLEASE, _PLEASE, _END)
    return [*(please if before else []), *statement, *(please if after else []), *(end if stop else [])]


def _phrase(rng: np.random.Generator, adjective: str, noun: str, tag: Tag) -> TaggedText:
    """Returns a noun phrase, of which article and generic noun say nothing of what is meant."""
    article = _tagged(str(rng.choice(_ARTICLES)), Tag.NOTHING)
    generic = _tagged(str(rng.choice(_GENERIC_NOUNS)), Tag.NOTHING)
    forms = ([(adjective, tag), (noun, tag)], [(adjective, tag), *generic], [(adjective, tag)], [(noun, tag)])
    return [*article, *forms[rng.choice(len(forms), p=(0.6, 0.2, 0.1, 0.1))]]


def _comma(rng: np.random.Generator, probability: float) -> TaggedText:
    return [(",", Tag.NOTHING)] if rng.random() < probability else []


def _tagged(words: str, tag: Tag) -> TaggedText:
    return [(word, tag) for word in words.split()]
