"""Goal texts that contradict each other: negative labels, from language alone, of frames that show another goal."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from freerein.goal_text import Grammar, Statement, noun_phrases
from freerein.relations import SpatialRelation

_CONVERSE: Mapping[SpatialRelation, SpatialRelation] = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: SpatialRelation.RIGHT_OF,
        SpatialRelation.RIGHT_OF: SpatialRelation.LEFT_OF,
        SpatialRelation.ON_TOP_OF: SpatialRelation.BELOW,
        SpatialRelation.BELOW: SpatialRelation.ON_TOP_OF,
        SpatialRelation.APART_FROM: SpatialRelation.APART_FROM,
    }
)


def contradictions(texts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Returns the texts that contradict each of some: they state other relations of the same two things.

    Exactly one of the relations of `freerein.relations` holds of two things.
    """
    grammar = Grammar(noun_phrases(texts), texts)
    read = {text: said for text in texts if (said := grammar.read(text).statement) is not None}
    by_things: dict[frozenset[str], list[str]] = {}
    for text, said in read.items():
        by_things.setdefault(_things(said), []).append(text)
    rivals = {
        text: tuple(other for other in by_things[_things(said)] if _turned(read[other], said) != said.relation)
        for text, said in read.items()
    }
    return {text: rivals.get(text, ()) for text in texts}


def _things(said: Statement) -> frozenset[str]:
    return frozenset((said.first, said.second))


def _turned(said: Statement, beside: Statement) -> SpatialRelation:
    """Returns the relation that a statement states, of the two things in the order in which another one names them."""
    return said.relation if said.first == beside.first else _CONVERSE[said.relation]
