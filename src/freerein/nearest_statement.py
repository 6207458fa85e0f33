"""The statement that a text probably means where no grammar reads it: callers are asked back, it is never just taken.

A text that says two names and one relation, whatever else it says, is near their statement. Words that turn a statement
into another one, such as `not` and `two`, are never left out.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise, product, takewhile
from types import MappingProxyType
from typing import Generic, TypeVar

from freerein.relations import SpatialRelation

Words = tuple[str, ...]
R = TypeVar("R")

NEGATIONS = (
    *("not", "no", "never", "don", "t", "without", "except", "neither", "nor", "none", "nothing", "nowhere", "nobody"),
    *("cannot", "dont", "cant", "isnt", "arent", "wont", "doesnt", "didnt", "shouldnt", "mustnt"),
)
QUANTITIES = (
    *("all", "every", "each", "both", "any", "some", "several", "many", "few", "most", "half", "everything"),
    *("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "couple", "dozen"),
)
_CHANGES = (
    *("do", "does", "did", "or", "but", "if", "unless", "when", "then", "before", "after", "otherwise"),
    *("instead", "rather", "off", "from", "remove", "avoid", "prevent", "stop", "undo", "opposite"),
    *("other", "only", "false", "untrue", "wrong", "forbid", "forbids", "forbidden", "prohibited"),
    *("fail", "fails", "failed", "hate", "hates", "dislike", "dislikes", "refuse", "refuses"),
)
"""More words without which a text says something else."""

_MIN_LETTERS = 4
"""Shorter words are no typos: too many words are one edit apart."""

_POSSESSIVE = frozenset(("with", "has", "have", "having"))
_IGNORED = ("each other", "one another", "do you")
_BESIDE = (
    *("next to", "right next to", "beside", "right beside", "alongside", "adjacent to"),
    *("by the side of", "on the side of", "at the side of", "to the side of"),
)
"""They do not say on which side; the left is as near as the right."""


def _side(side: str) -> tuple[str, ...]:
    ends = (side, f"{side} side", f"{side} hand side", f"{side} from")
    return (side, f"{side} from", *(f"{before} the {end}" for before, end in product(("on", "to", "at"), ends)))


_LOOSE: Mapping[SpatialRelation, tuple[str, ...]] = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: (*_side("left"), *_BESIDE),
        SpatialRelation.RIGHT_OF: _side("right"),
        SpatialRelation.ON_TOP_OF: ("on top", "on the top", "at the top of", "right on top of", "higher than"),
        SpatialRelation.BELOW: ("at the bottom of", "right below", "right under", "lower than"),
        SpatialRelation.APART_FROM: ("apart", "far apart", "way from", "distance from", "possible from"),
    }
)


class NearestStatement(Generic[R]):
    """Finds the statement of names that is nearest to a text; R are the relations.

    Args:
        names: The phrase that each name stands for.
        relations: The relation that each wording says.
        loosely: The relation that each wording nearly says, as `LOOSELY`.
    """

    def __init__(self, names: Mapping[Words, str], relations: Mapping[Words, R], loosely: Mapping[Words, R]) -> None:
        self._names, self._definite = names, relations
        self._relations = {**loosely, **relations}
        self._mentions = frozenset((*names, *self._relations, *map(_split, _IGNORED)))
        self._longest = max(map(len, self._mentions))
        self._spellings = frozenset(word for mention in self._mentions for word in mention)

    def find(self, said: Words, unknown: Iterable[str]) -> tuple[str, R, str] | None:
        """Returns the statement nearest to words; None where none is near.

        It is that of the words as they are or, where they make none, with the unknown ones for typos.
        """
        meant = {word: self._meant(word) for word in unknown}
        if NEGATIONS[:1] in meant.values():
            return None
        spelled = tuple(each for word in said for each in meant.get(word, (word,)))
        return self._find(said) or self._find(spelled)

    def _find(self, said: Words) -> tuple[str, R, str] | None:
        parts = list(self._parts(said))
        rest = {word for part in parts if part not in self._mentions for word in part}
        if any(map(_means_another, rest)):
            return None
        return self._stated(parts, is_possessed=not rest.isdisjoint(_POSSESSIVE))

    def _parts(self, said: Words) -> Iterator[Words]:
        """Yields names, relations and single other words in order; the longest that there are."""
        place = 0
        while place < len(said):
            sizes = range(min(self._longest, len(said) - place), 1, -1)
            size = next((size for size in sizes if said[place : place + size] in self._mentions), 1)
            yield said[place : place + size]
            place += size

    def _stated(self, parts: list[Words], *, is_possessed: bool) -> tuple[str, R, str] | None:
        """Returns what two names and one relation state; None for other numbers of them.

        They are `A on B`, `on B is A`, `B with A on it`, `A and B apart`, `B's left is A` or `A at B's left`.
        """
        names = [self._names[part] for part in parts if part in self._names]
        relations = [place for place, part in enumerate(parts) if part in self._relations]
        if len(names) != 2 or len(relations) != 1 or names[0] == names[1]:
            return None
        wording, (first, second) = parts[relations[0]], names
        before = sum(part in self._names for part in parts[: relations[0]])
        owners = [self._names[part] for part, end in pairwise(parts) if part in self._names and end == ("s",)]
        if owners and wording not in self._definite and wording not in _MUTUAL:
            is_converse = owners[0] == first
        elif before == 1 or wording in _MUTUAL:
            is_converse = False
        elif is_possessed if before == 2 else wording in self._definite:
            is_converse = True
        else:
            return None
        relation = self._relations[wording]
        return (second, relation, first) if is_converse else (first, relation, second)

    def _meant(self, word: str) -> Words:
        """Returns the word that is one edit away, or whose plural this is, or two without their space; else the word.

        Of several, the only one with the same first letter is meant: it is seldom mistyped.
        """
        if len(word) < _MIN_LETTERS or word in _MEANS_ANOTHER:
            return (word,)
        if any(_is_one_edit(word, negation) for negation in NEGATIONS):
            return NEGATIONS[:1]
        near: list[Words] = [(each,) for each in self._spellings if word == f"{each}es" or _is_one_edit(word, each)]
        near = [each for each in near if each[0][0] == word[0]] if len(near) > 1 else near
        parted = [(word[:end], word[end:]) for end in range(1, len(word))]
        near = near or [pair for pair in parted if self._spellings.issuperset(pair)]
        return near[0] if len(near) == 1 else (word,)


def _means_another(word: str) -> bool:
    """Returns whether a text without this word, number or sign might say something else."""
    return word in _MEANS_ANOTHER or word.isnumeric() or not (word.isalnum() or word.isascii())


def _is_one_edit(one: str, other: str) -> bool:
    """Returns whether words differ by one letter more, less or other, or by the order of two, in linear time."""
    start = _shared(one, other)
    one, other = one[start:], other[start:]
    end = _shared(one[::-1], other[::-1])
    one, other = one[: len(one) - end], other[: len(other) - end]
    return max(len(one), len(other)) <= 1 or (len(one) == 2 and one == other[::-1])


def _shared(one: str, other: str) -> int:
    """Returns the length of the beginning that two words share."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))


def _split(text: str) -> Words:
    return tuple(text.split())


_MEANS_ANOTHER = frozenset((*NEGATIONS, *QUANTITIES, *_CHANGES))
LOOSELY: Mapping[Words, SpatialRelation] = MappingProxyType(
    {_split(wording): relation for relation, wordings in _LOOSE.items() for wording in wordings}
)
"""Wordings that no grammar reads, with the relation that they may mean."""

_MUTUAL = frozenset(map(_split, (*_BESIDE, *_LOOSE[SpatialRelation.APART_FROM], "apart from", "far from", "away from")))
