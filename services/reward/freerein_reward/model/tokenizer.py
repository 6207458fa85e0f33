"""Word-level tokenizer; all unknown words share one token."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from freerein.goal_text import words

MAX_TOKENS = 77
"""Longest token sequence, end-of-text token included, as in CLIP."""

END, UNKNOWN = 1, 2
"""Tokens of a text's end, and of every word that is not in the vocabulary. No training text has one."""

_FIRST_WORD = 3


class Tokens(NamedTuple):
    """Tokenized texts.

    Attributes:
        ids: int64 (K, L), tokens, end-of-text token, zero padding.
        truncated: bool (K,), whether a text was cut to `MAX_TOKENS`.
    """

    ids: npt.NDArray[np.int64]
    truncated: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tokenizer:
    """Turns texts into tokens, in linear time; `vocabulary` holds the known words, casefolded, in token order."""

    vocabulary: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of different tokens."""
        return _FIRST_WORD + len(self.vocabulary)

    def __call__(self, texts: Sequence[str]) -> Tokens:
        """Returns the tokens of one or more texts."""
        index = {word: _FIRST_WORD + place for place, word in enumerate(self.vocabulary)}
        split = [words(text) for text in texts]
        kept = [each[: MAX_TOKENS - 1] for each in split]
        ids = np.zeros((len(texts), 1 + max(map(len, kept))), np.int64)
        for row, each in zip(ids, kept, strict=True):
            row[: len(each)] = [index.get(word, UNKNOWN) for word in each]
            row[len(each)] = END
        return Tokens(ids, np.array([len(each) >= MAX_TOKENS for each in split]))
