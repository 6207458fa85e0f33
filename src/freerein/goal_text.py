"""Goal texts, read by a small grammar: a statement that two of a model's noun phrases stand in a relation.

    [please] [could you] [put] PHRASE [is] RELATION PHRASE [please]

Case and punctuation do not matter. A phrase may have another article, its last word a synonym or `one`, and that word
may be missing where the rest still names one phrase. Whatever else a text says, it is not a statement; the nearest one
is proposed.
"""

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from types import MappingProxyType

from freerein.errors import InvalidInput
from freerein.nearest_statement import LOOSELY, NEGATIONS, QUANTITIES, NearestStatement
from freerein.relations import MISSING, SpatialRelation, absence_caption, caption

Words = tuple[str, ...]

POLITE = "please"
ARTICLES = ("a", "an", "the", "one", "this", "that")
GENERIC_NOUNS = ("one", "object", "thing")
SYNONYMS: Mapping[str, tuple[str, ...]] = MappingProxyType({"block": ("cube",), "ball": ("sphere",)})
"""Other names of a noun."""

REQUESTS = (
    *(
        "could you",
        "can you",
        "would you",
        "will you",
        "i want",
        "i want you to",
        "i would like",
        "i would like you to",
    ),
    *("i need", "make sure", "make sure that"),
)
"""Openings of a sentence that carry no meaning."""

OPENINGS = (
    *("i d like", "we want", "we need", "you to", "you should", "you must", "let", "ensure", "ensure that"),
    *("there is", "there to be", "there should be", "there must be"),
)
"""As `REQUESTS`, of words that noun phrases may have, too."""

ARRANGE = "arrange"
SO_THAT = ("so", "that")
VERBS = ("put", "place", "move", "push", "pull", "set", "bring", "slide", "stack", "lay", "get", "keep", "make")
COPULAS = (
    *("is", "are", "should be", "must be", "lies", "sits", "rests", "stands", "goes", "stays", "belongs"),
    *("is placed", "is lying", "is sitting", "is resting", "is standing"),
    *("be", "to be", "should go", "go", "sit", "stand", "lie", "stay"),
)
_MODALS = ("should", "must", "has to", "needs to", "to")
CLAUSES = (
    *map(" ".join, product(_MODALS, ("be", "go", "sit", "stand", "lie", "stay", "rest", "be placed"))),
    *map(" ".join, product(("that", "which"), ("is", "lies", "sits", "rests", "stands", "goes", "stays"))),
)
"""As `COPULAS`, of words that noun phrases may have, too."""

MAX_UNKNOWN = 16
"""Most unknown words that are named."""

MAX_UNKNOWN_CHARACTERS = 32
"""Longer words are cut."""

_NEARBY = ("beside", "next to", "close")
"""Known only before a side: alone they do not say which."""

NEARBY_WORDS = frozenset(each.split()[0] for each in _NEARBY)

_EXACTLY = ("just", "directly")
_PIECE = re.compile(r"\S{1,64}|\s+")  # normalising a long run of combining marks takes quadratic time
_UNSPOKEN = re.compile(r"(?:[^\w\s]|_)+")


def _wordings(side: str) -> tuple[str, ...]:
    """Returns the wordings of `left` or `right`."""
    ends = (f"{side} of", f"{side} side of", f"{side} hand side of")
    plain = [" ".join(filter(None, parts)) for parts in product(("to the", "on the", "at the", ""), ends)]
    return (*plain, *(f"{before} {each}" for before, each in product((*_NEARBY, *_EXACTLY), plain)))


def _exactly(*plain: str) -> tuple[str, ...]:
    return (*plain, *(f"{before} {each}" for before, each in product(_EXACTLY, plain)))


WORDINGS: Mapping[SpatialRelation, tuple[str, ...]] = MappingProxyType(
    {
        SpatialRelation.LEFT_OF: _wordings("left"),
        SpatialRelation.RIGHT_OF: _wordings("right"),
        SpatialRelation.ON_TOP_OF: _exactly(
            "on top of", "on the top of", "on", "onto", "upon", "above", "over", "atop"
        ),
        SpatialRelation.BELOW: _exactly("below", "under", "underneath", "beneath"),
        SpatialRelation.APART_FROM: ("apart from", "far apart from", "far from", "far away from", "away from"),
    }
)


@dataclass(frozen=True)
class Statement:
    """A relation of two different noun phrases of a model, as the model spells them."""

    first: str
    relation: SpatialRelation
    second: str

    @property
    def caption(self) -> str:
        """The statement in the words of the model's training."""
        return caption(self.first, self.relation, self.second)

    @property
    def rivals(self) -> tuple[str, ...]:
        """The captions with each other relation, and the one of either missing."""
        others = [caption(self.first, each, self.second) for each in SpatialRelation if each is not self.relation]
        return (*others, absence_caption(self.first, self.second))


@dataclass(frozen=True)
class GoalText:
    """A text as a grammar reads it.

    Attributes:
        text: What the model is given: the statement's caption, or the text itself, of a grounding model the words that
            it was trained on.
        rivals: What it says with each other relation; empty without a relation, and of a grounding model.
        statement: The relation that it states; None where it states none, as by a grammar of criteria.
        unknown: Words that the model does not know, distinct and in order, at most `MAX_UNKNOWN` of at most
            `MAX_UNKNOWN_CHARACTERS` characters each. Empty for a statement.
        did_you_mean: The caption of the nearest statement; empty where none is near, and for a statement.
        problem: Why a model cannot be asked this text, a sentence; empty where it can.
    """

    text: str
    rivals: tuple[str, ...]
    statement: Statement | None
    unknown: Words
    did_you_mean: str = ""
    problem: str = ""


class Grammar:
    """The grammar of a model that was trained on texts of the words `vocabulary`.

    Negations and quantities are unknown words, except in a phrase. Without `phrases`, as of a grounding model, no text
    is a statement, and the grammar's words are known: such a model tells things, and is not given the others, such as
    `on`, nor those `untold`.
    """

    def __init__(self, phrases: Sequence[str], vocabulary: Sequence[str], *, untold: Iterable[str] = ()) -> None:
        self._phrases = names_of(phrases)
        self._longest = max(map(len, self._phrases), default=0)
        pairs = permutations(phrases, 2)
        self._absences = {words(each): each for each in (absence_caption(first, second) for first, second in pairs)}
        trained = frozenset(word for text in (*vocabulary, *phrases) for word in words(text)) - _ABSENCE_WORDS
        self._things = {f"{name[-1]}s" for name in (*self._phrases, *((noun,) for noun in GENERIC_NOUNS))}
        unread = _UNREAD.difference(*self._phrases) if phrases else frozenset[str]()
        others = _REQUEST_WORDS if phrases else untold
        self._known = trained.union(_GRAMMAR_WORDS, *self._phrases, others) - unread
        self._embedded = trained - unread if phrases else self._known
        self._untold = frozenset[str]() if phrases else self._known - trained
        self._nearest = NearestStatement(self._phrases, _WORDINGS, LOOSELY)

    def read(self, text: str) -> GoalText:
        """Returns the reading of a text, in linear time.

        A text that cannot be read goes to the model as it is. Words that only the grammar knows do not help it: they
        are named as unknown, too, where there are no others. Where the model knows all words, but has phrases that the
        text does not relate, the text states nothing, and has no rivals.
        """
        said = words(text)
        if statement := self._statement(said):
            return GoalText(statement.caption, statement.rivals, statement, ())
        if absence := self._absences.get(said):
            return GoalText(absence, (), None, ())
        strange = words_outside(said, self._known)
        unknown = strange or words_outside(said, self._embedded)
        rivals = _rivals(said) if unknown and self._phrases else ()
        nearest = self._nearest.find(said, strange)
        told = " ".join(word for word in said if word not in self._untold) if self._untold.intersection(said) else text
        return GoalText(told or text, rivals, None, unknown, caption(*nearest) if nearest else "")

    @property
    def states_goals(self) -> bool:
        """Whether the model has noun phrases, so that texts can state something; a grounding model has none."""
        return bool(self._phrases)

    def unknown_words(self, phrases: Iterable[str]) -> Words:
        """Returns the words of noun phrases that neither the grammar nor the model knows, as `GoalText.unknown`."""
        return words_outside((word for phrase in phrases for word in words(phrase)), self._known)

    def _statement(self, said: Words) -> Statement | None:
        said = self.wished(said)
        sizes = range(1, min(len(said), 1 + self._longest) + 1)
        firsts = [(size, found) for size in sizes if (found := self._phrase(said[:size]))]
        seconds = [(size, found) for size in sizes if (found := self._phrase(said[-size:]))]
        read = {
            Statement(first, relation, second)
            for (before, first), (after, second) in product(firsts, seconds)
            if first != second and (relation := _RELATIONS.get(said[before : len(said) - after])) is not None
        }
        return read.pop() if len(read) == 1 else None

    def wished(self, said: Words) -> Words:
        """Returns the words of a sentence without those that only ask for it, and without its verb."""
        said = self._arranged(asked(said))
        return said[1:] if said[:1] and said[0] in VERBS else said

    def _arranged(self, said: Words) -> Words:
        """Returns what is to hold after `arrange the blocks so that`."""
        rest = bare_words(said[1:])
        begins = said[:1] == (ARRANGE,) and rest[:1] and rest[0] in self._things and rest[1:3] == SO_THAT
        return rest[3:] if begins else said

    def _phrase(self, said: Words) -> str | None:
        """Returns the phrase of these words, which may begin with an article."""
        return self._phrases.get(said) or self._phrases.get(bare_words(said))


def ask_back(did_you_mean: str, otherwise: str) -> str:
    """Returns the hint of an error of a goal text: asks for the nearest statement, where there is one."""
    return f"Did you mean: {did_you_mean}?" if did_you_mean else otherwise


def not_known(unknown: Words, did_you_mean: str, *, field: str) -> InvalidInput:
    """Returns the error of a text with unknown words, a goal text or a rival by its field."""
    example = "Relate two noun phrases of the model in English, such as: the red block is on the blue one."
    return InvalidInput(
        f"The model must know every word of `{field}`; it does not know {', '.join(unknown)}.",
        field=field,
        hint=ask_back(did_you_mean, example),
    )


def words(text: str) -> Words:
    """Returns a text's words, casefolded, in linear time.

    Punctuation and control characters separate words. Symbols are words, as are marks that no letter takes.
    """
    folded = "".join(map(_fold, _PIECE.findall(text)))
    return tuple(_UNSPOKEN.sub(_symbols, folded).split())


def asked(said: Words) -> Words:
    """Returns the words of a sentence without those that only ask for it."""
    start = 0
    while size := next((size for size in _REQUEST_SIZES if said[start : start + size] in _REQUESTS), 0):
        start += size
    said = said[start:]
    return said[:-1] if said[-1:] == (POLITE,) else said


def stated(text: str) -> Words:
    """Returns the words of a text, also of one that asks for what it states."""
    said = asked(words(text))
    return said[1:] if said[:1] and said[0] in VERBS else said


def noun_phrases(texts: Iterable[str]) -> tuple[str, ...]:
    """Returns the two noun phrases of each text that relates two, once each, whatever their articles."""
    found: dict[Words, str] = {}
    for text in texts:
        for phrase in _related(stated(text)):
            found.setdefault(bare_words(phrase), " ".join(phrase))
    return tuple(found.values())


def rival_captions(text: str) -> tuple[str, ...]:
    """Returns the text with its first relation replaced by each other one; empty without a relation."""
    return _rivals(words(text))


def bare_words(phrase: Words) -> Words:
    """Returns the words of a noun phrase without its article."""
    return phrase[1:] if len(phrase) > 1 and phrase[0] in ARTICLES else phrase


def _rivals(said: Words) -> tuple[str, ...]:
    for start in (place for place, word in enumerate(said) if word in _RELATION_STARTS):
        for end in range(min(len(said), start + _LONGEST_RELATION), start, -1):
            if (relation := _WORDINGS.get(said[start:end])) is not None:
                before, after = " ".join(said[:start]), " ".join(said[end:])
                others = (each for each in SpatialRelation if each is not relation)
                return tuple(caption(before, other, after).strip() for other in others)
    return ()


def _related(said: Words) -> tuple[Words, ...]:
    """Returns the words before and after the first relation, where both are noun phrases; else nothing."""
    for start in range(1, len(said)):
        for end in range(min(len(said) - 1, start + _LONGEST_RELATED), start, -1):
            if said[start:end] in _RELATIONS:
                phrases = said[:start], said[end:]
                return phrases if all(map(is_noun_phrase, phrases)) else ()
    return ()


def is_noun_phrase(said: Words) -> bool:
    """Returns whether words may be a noun phrase: few, and none that makes a sentence.

    `a cup with a handle` is one; `contact with a cup` is the end of a relation that nobody knows.
    """
    bare = bare_words(said)
    if bare == said and _PLAIN_ARTICLES.intersection(said):
        return False
    return 0 < len(bare) <= _LONGEST_PHRASE and bare[0] not in ARTICLES and not _NO_NOUNS.intersection(bare)


def names_of(phrases: Sequence[str]) -> dict[Words, str]:
    """Returns what names exactly one of the phrases; their own words come before synonyms, these before the rest."""
    named: dict[Words, set[str]] = {}
    for variants in (_own, _synonymous, _generic):
        found: dict[Words, set[str]] = {}
        for phrase in phrases:
            for name in variants(bare_words(words(phrase))):
                found.setdefault(name, set()).add(phrase)
        named = found | named
    return {name: among.pop() for name, among in named.items() if len(among) == 1}


def _own(phrase: Words) -> Iterator[Words]:
    if phrase:
        yield phrase


def _synonymous(phrase: Words) -> Iterator[Words]:
    yield from ((*phrase[:-1], other) for noun in phrase[-1:] for other in _SAME.get(noun, ()))


def _generic(phrase: Words) -> Iterator[Words]:
    """Yields the words before the noun, alone and with a generic noun."""
    if len(phrase) > 1:
        yield phrase[:-1]
        yield from ((*phrase[:-1], noun) for noun in GENERIC_NOUNS)


def words_outside(said: Iterable[str], known: frozenset[str]) -> Words:
    """Returns the words that are not known, as `GoalText.unknown`."""
    cut = (word[:MAX_UNKNOWN_CHARACTERS] for word in said if word not in known)
    return tuple(dict.fromkeys(cut))[:MAX_UNKNOWN]


def _fold(text: str) -> str:
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).casefold())


def _symbols(unspoken: re.Match[str]) -> str:
    kept = (character for character in unspoken[0] if unicodedata.category(character)[0] in "SM")
    return f" {''.join(kept)} "


def _split(texts: Iterable[str]) -> frozenset[str]:
    return frozenset(word for text in texts for word in text.split())


_SAME = {name: (noun, *others) for noun, others in SYNONYMS.items() for name in (noun, *others)}
_WORDINGS = {tuple(each.split()): relation for relation, wordings in WORDINGS.items() for each in wordings}
_LONGEST_RELATION = max(map(len, _WORDINGS))
_RELATION_STARTS = frozenset(wording[0] for wording in _WORDINGS)
_RELATIONS = {
    (*copula.split(), *wording): relation
    for copula, (wording, relation) in product(("", *COPULAS, *CLAUSES), _WORDINGS.items())
}
_LONGEST_RELATED = max(map(len, _RELATIONS))
_LONGEST_PHRASE = 6
_REQUESTS = frozenset(tuple(each.split()) for each in (POLITE, *REQUESTS, *OPENINGS))
_REQUEST_SIZES = range(max(map(len, _REQUESTS)), 0, -1)
_REQUEST_WORDS = _split((*REQUESTS, *OPENINGS, *CLAUSES, ARRANGE, *SO_THAT))
_UNREAD = frozenset((*NEGATIONS, *QUANTITIES))
_ABSENCE_WORDS = frozenset(("or", MISSING))
_GRAMMAR_WORDS = _split((POLITE, *ARTICLES, *GENERIC_NOUNS, *VERBS, *COPULAS, *map(" ".join, _WORDINGS))) - NEARBY_WORDS
_NO_NOUNS = _split(
    (POLITE, *VERBS, *COPULAS, *map(" ".join, _WORDINGS), *REQUESTS, *_UNREAD, "and or but then it them between")
)
_PLAIN_ARTICLES = frozenset(("a", "an", "the"))
