"""Goal texts and captions of models that know the criteria of table 4.1.

    [please] [could you] [put] PHRASE [is] WORDING PHRASE [and PHRASE] [please]

A caption says that a criterion holds of two or three phrases, that it fails, or that not all of them are shown:

    a red block on top of a blue block
    a red block not on top of a blue block
    a red block or a blue block missing

Goal texts say the first, in any wording. The others are their rivals: where a criterion fails and none that excludes it
holds, something must win against the goal.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product

from freerein.criteria import CRITERIA, Criterion, View
from freerein.goal_text import (
    ARTICLES,
    CLAUSES,
    COPULAS,
    GoalText,
    Grammar,
    Words,
    bare_words,
    is_noun_phrase,
    names_of,
    stated,
    words,
    words_outside,
)
from freerein.nearest_statement import LOOSELY, NearestStatement
from freerein.relations import MISSING

NOT, AND, OR = "not", "and", "or"


class Claim(Enum):
    """The claim of a caption about a criterion and its nouns."""

    HOLDS = "holds"
    FAILS = "fails"
    MISSING = "missing"


@dataclass(frozen=True)
class CriterionCaption:
    """A caption.

    Attributes:
        claim: What it says.
        criterion: Of what it says it; None for `MISSING`, which is the same for all criteria.
        nouns: Two or three different noun phrases, as the model spells them.
    """

    claim: Claim
    criterion: Criterion | None
    nouns: Words

    @property
    def text(self) -> str:
        """The caption in words."""
        if self.criterion is None:
            return f"{f' {OR} '.join(self.nouns)} {MISSING}"
        said = self.criterion.wordings[0]
        return (said if self.claim is Claim.HOLDS else said.replace("{0}", f"{{0}} {NOT}")).format(*self.nouns)

    @property
    def rivals(self) -> tuple[str, ...]:
        """The captions of the criteria that exclude this one, that it fails, and that not all nouns are shown."""
        if self.criterion is None or self.claim is not Claim.HOLDS:
            return ()
        excluded = [CriterionCaption(Claim.HOLDS, CRITERIA[name], self.nouns) for name in self.criterion.excludes]
        fails = CriterionCaption(Claim.FAILS, self.criterion, self.nouns)
        return tuple(each.text for each in (*excluded, fails, CriterionCaption(Claim.MISSING, None, self.nouns)))


class CriterionGrammar(Grammar):
    """The grammar of a model that knows the criteria of some views.

    Args:
        phrases: Noun phrases of the model's fit.
        views: The views that the model has; criteria of others are refused.
        other_phrases: More phrases that it can be asked for. Where a name fits several, that of the fit is meant.
    """

    def __init__(self, phrases: Sequence[str], views: Iterable[View], other_phrases: Sequence[str] = ()) -> None:
        super().__init__((*phrases, *other_phrases), _VOCABULARY)
        self._phrases = {**self._phrases, **names_of(phrases)}
        self.views = tuple(views)
        self.criteria = tuple(each for each in CRITERIA.values() if each.view in self.views)
        by_name = {each.name: each for each in self.criteria}
        loosely = {said: by_name[name] for said, each in LOOSELY.items() if (name := each.name.lower()) in by_name}
        plain = {said: each for said, each in _BINARY.items() if each in self.criteria}
        self._nearest_pair = NearestStatement(self._phrases, plain, loosely)

    def read(self, text: str) -> GoalText:
        """Returns the reading of a text, in linear time; one that says nothing of this model has a `problem`."""
        said = words(text)
        if caption := self.caption(text):
            return GoalText(caption.text, caption.rivals, None, ())
        if fault := next(filter(None, map(self._fault, self._candidates(said))), ""):
            return GoalText(text, (), None, (), "", fault)
        unknown = words_outside(said, self._known)
        nearest = self._nearest_pair.find(said, unknown)
        meant = CriterionCaption(Claim.HOLDS, nearest[1], (nearest[0], nearest[2])).text if nearest else ""
        return GoalText(
            text, (), None, unknown, meant, "" if unknown else "It states no criterion of different things."
        )

    def caption(self, text: str) -> CriterionCaption | None:
        """Returns the caption that a text is, in any wording of its criterion; None where it is none."""
        read = {each for each in self._candidates(words(text)) if not self._fault(each)}
        return read.pop() if len(read) == 1 else None

    def phrase(self, text: str) -> str | None:
        """Returns the noun phrase that a text names, as the model spells it; None for another text."""
        return self._phrase(words(text))

    def _candidates(self, said: Words) -> Iterator[CriterionCaption]:
        """Yields what words may say, also with too few or too many nouns, or of a view that the model has not."""
        said = self.wished(said)
        for first, rest in self._after_noun(said):
            for size in range(1, min(len(rest), _LONGEST) + 1):
                for claim, criterion, tails in _READINGS.get(rest[:size], ()):
                    for nouns in self._nouns(rest[size:], tails):
                        yield CriterionCaption(claim, criterion, (first, *nouns))

    def _nouns(self, said: Words, tails: Sequence[Words]) -> Iterator[Words]:
        """Yields the nouns of words that are a noun and its tail, for each of `tails`, and nothing else."""
        if not tails:
            yield from () if said else ((),)
            return
        for noun, rest in self._after_noun(said):
            if rest[: len(tails[0])] == tails[0]:
                yield from ((noun, *others) for others in self._nouns(rest[len(tails[0]) :], tails[1:]))

    def _after_noun(self, said: Words) -> Iterator[tuple[str, Words]]:
        """Yields each noun phrase that words begin with, and the words after it."""
        for size in range(1, min(len(said), 1 + self._longest) + 1):
            if noun := self._phrase(said[:size]):
                yield noun, said[size:]

    def _fault(self, caption: CriterionCaption) -> str:
        """Returns why a caption is none of this model, a sentence; empty where it is one."""
        criterion, nouns = caption.criterion, caption.nouns
        if criterion and criterion not in self.criteria:
            views = ", ".join(each.name.lower() for each in self.views)
            return f"`{criterion.name}` is judged in the {criterion.view.name.lower()} view; the model has {views}."
        if criterion and criterion.nouns != len(nouns):
            return f"`{criterion.name}` relates {criterion.nouns} things; {len(nouns)} are named."
        twice = [noun for noun in nouns if nouns.count(noun) > 1]
        return f"A thing must be named once; {twice[0]} is named twice." if twice else ""


def stated_criterion(text: str) -> tuple[Criterion, Words] | None:
    """Returns the criterion that a text states, and its nouns, which no model need know; None where it states none.

    The first and longest wording counts. A wording that its noun goes on with is half of a longer one: `red in front
    blue` says nothing.
    """
    said = stated(text)
    for start in range(1, len(said)):
        for end in range(min(len(said) - 1, start + _LONGEST), start, -1):
            if said[start : end + 1] in _HALVES:
                continue
            for claim, criterion, tails in _READINGS.get(said[start:end], ()):
                nouns = (said[:start], *_split(said[end:], tails))
                if claim is not Claim.HOLDS or criterion is None or len(nouns) != criterion.nouns:
                    continue
                if len(set(map(bare_words, nouns))) == len(nouns) and all(map(is_noun_phrase, nouns)):
                    return criterion, tuple(map(" ".join, nouns))
    return None


def _split(said: Words, tails: Sequence[Words]) -> tuple[Words, ...]:
    """Returns the words before each tail; an empty one is the end."""
    parts = []
    for tail in tails:
        end = next((at for at in range(len(said)) if tail and said[at : at + len(tail)] == tail), len(said))
        parts.append(said[:end])
        said = said[end + len(tail) :]
    return tuple(parts)


Reading = tuple[Claim, Criterion | None, tuple[Words, ...]]
"""What is said, and the words that follow each noun but the first."""


def _parts(wording: str) -> tuple[Words, tuple[Words, ...]]:
    """Returns the words between the first two nouns of a wording, and those that follow the other nouns."""
    after = [tuple(part.split()) for part in wording.replace("{1}", "|").replace("{2}", "|").split("|")]
    return after[0][1:], tuple(after[1:])


def _all_readings() -> Iterator[tuple[Words, Reading]]:
    """Yields readings by the words after the first noun."""
    for criterion in CRITERIA.values():
        for wording, copula in product(criterion.wordings, ("", *COPULAS, *CLAUSES)):
            key, _ = _parts(wording)
            for tails in _TAILS:
                yield (*copula.split(), *key), (Claim.HOLDS, criterion, tails)
        key, tails = _parts(criterion.wordings[0])
        yield (NOT, *key), (Claim.FAILS, criterion, tails)
    yield (OR,), (Claim.MISSING, None, ((MISSING,),))
    yield (OR,), (Claim.MISSING, None, ((OR,), (MISSING,)))


def _grouped(readings: Iterable[tuple[Words, Reading]]) -> Mapping[Words, tuple[Reading, ...]]:
    grouped: dict[Words, tuple[Reading, ...]] = {}
    for key, reading in readings:
        grouped[key] = (*grouped.get(key, ()), reading)
    return grouped


_TAILS: tuple[tuple[Words, ...], ...] = (((),), ((AND,), ()))
"""What follows the other nouns of two, and of three."""

_READINGS = _grouped(_all_readings())
_LONGEST = max(map(len, _READINGS))
_HALVES = {
    key[:size] for key in _READINGS for size in range(2, len(key)) if key[size - 1] not in ARTICLES
} - _READINGS.keys()
"""What longer wordings begin with."""

_VOCABULARY = tuple(sorted({AND, *(word for key in _READINGS for word in key)}))
_BINARY = {
    _parts(each)[0]: criterion for criterion in CRITERIA.values() if criterion.nouns == 2 for each in criterion.wordings
}
