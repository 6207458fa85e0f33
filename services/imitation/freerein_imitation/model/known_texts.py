"""Goal texts that a policy accepts: those that state a training text's goal, or a relation of two objects.

The objects are those of the training texts, and those that a policy can find without training on them.

A network makes something of any text, of `do not put A on B` much the same as of `put A on B`. So goal texts are read
by the grammar that the reward's are read by, and what that cannot read is no goal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from freerein.goal_text import Grammar, Words, asked, bare_words, noun_phrases, words

_MAX_PHRASES = 64
_ARTICLES = frozenset(("a", "an", "the"))


@dataclass(frozen=True)
class KnownText:
    """A text as a policy's training has it.

    Attributes:
        training_text: The training text that says the same; None where none does.
        caption: The relation that it states, in the words of captions; None where it states none of two known objects.
        unknown: Words that no training text has, as `freerein.goal_text.GoalText.unknown`.
        did_you_mean: The nearest relation of two known objects, as `freerein.goal_text.GoalText.did_you_mean`.
    """

    training_text: str | None
    caption: str | None
    unknown: Words
    did_you_mean: str = ""


class KnownTexts:
    """Reads goal texts of a policy.

    Args:
        texts: The texts that it was trained on.
        objects: Further noun phrases that it knows.
        any_object: Whether it acts on whatever noun phrases a text relates.
    """

    def __init__(self, texts: Sequence[str], *, objects: Sequence[str] = (), any_object: bool = False) -> None:
        trained = noun_phrases(texts)[:_MAX_PHRASES]
        self._phrases = (*trained, *_further(objects, trained))
        self._texts = texts
        self._any_object = any_object
        self._grammar = Grammar(self._phrases, texts)
        self._by_words = {_plain(text): text for text in texts}
        read = ((self._grammar.read(text).statement, text) for text in texts)
        self._by_statement = {statement: text for statement, text in read if statement is not None}

    def read(self, text: str) -> KnownText:
        """Returns the statement of a text."""
        goal = self._grammar.read(text)
        if goal.statement is None and self._any_object:
            goal = self._with_objects_of(text).read(text)
        same = self._by_words.get(_plain(text))
        if goal.statement is None:
            return KnownText(same, None, goal.unknown, goal.did_you_mean)
        return KnownText(same or self._by_statement.get(goal.statement), goal.text, ())

    def _with_objects_of(self, text: str) -> Grammar:
        """Returns a grammar that has the objects of a text, too."""
        named = _further(noun_phrases([text]), self._phrases)
        return Grammar((*self._phrases, *named), self._texts) if named else self._grammar


def _further(phrases: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Returns the noun phrases that are not among the known ones, whatever their articles."""
    bare = {bare_words(words(each)) for each in known}
    return tuple(each for each in phrases if bare_words(words(each)) not in bare)


def _plain(text: str) -> Words:
    """Returns the words that say something."""
    said = asked(words(text))
    return tuple(word for word in said if word not in _ARTICLES) or said
