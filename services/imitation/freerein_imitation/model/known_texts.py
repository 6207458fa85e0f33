"""Which goal texts a policy can act on: what one of its training texts says, or a relation of two of their objects.

A network makes something of any text, of `do not put A on B` much the same as of `put A on B`. So goal texts are read
by the grammar that the reward's are read by, and what that cannot read is no goal.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from freerein.goal_text import Grammar, Words, asked, noun_phrases, words

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
    """Reads goal texts of a policy that was trained on `texts`."""

    def __init__(self, texts: Sequence[str]) -> None:
        self._grammar = Grammar(noun_phrases(texts)[:_MAX_PHRASES], texts)
        self._by_words = {_plain(text): text for text in texts}
        read = ((self._grammar.read(text).statement, text) for text in texts)
        self._by_statement = {statement: text for statement, text in read if statement is not None}

    def read(self, text: str) -> KnownText:
        """Returns what a text says."""
        goal = self._grammar.read(text)
        same = self._by_words.get(_plain(text))
        if goal.statement is None:
            return KnownText(same, None, goal.unknown, goal.did_you_mean)
        return KnownText(same or self._by_statement.get(goal.statement), goal.text, ())


def _plain(text: str) -> Words:
    """Returns the words that say something."""
    said = asked(words(text))
    return tuple(word for word in said if word not in _ARTICLES) or said
