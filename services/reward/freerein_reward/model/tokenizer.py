"""Word-level tokenizer; unknown words are hashed into a few buckets."""

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

MAX_TOKENS = 77
"""Longest token sequence, end-of-text token included, as in CLIP."""

BUCKETS = 16
END = 1
_FIRST_BUCKET = 2
_FIRST_WORD = _FIRST_BUCKET + BUCKETS
_MAX_WORD = 64
_WORD = re.compile(r"[^\W_]+|[^\w\s]|_")


class Tokens(NamedTuple):
    """Tokenized texts.

    Attributes:
        ids: int64 (K, L), tokens, end-of-text token, zero padding.
        truncated: bool (K,), whether a text was cut to `MAX_TOKENS`.
        unknown: int64 (K,), number of out-of-vocabulary words of the whole text.
    """

    ids: npt.NDArray[np.int64]
    truncated: npt.NDArray[np.bool_]
    unknown: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tokenizer:
    """Splits texts into words, in linear time; `vocabulary` holds the known words, in lower case, in token order."""

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
            row[: len(each)] = [index.get(word) or _bucket(word) for word in each]
            row[len(each)] = END
        return Tokens(
            ids,
            np.array([len(each) >= MAX_TOKENS for each in split]),
            np.array([sum(word not in index for word in each) for each in split]),
        )


def words(text: str) -> list[str]:
    """Returns a text's words in lower case; punctuation marks are words of their own."""
    return _WORD.findall(text.lower())


def _bucket(word: str) -> int:
    return _FIRST_BUCKET + zlib.crc32(word[:_MAX_WORD].encode(errors="replace")) % BUCKETS
