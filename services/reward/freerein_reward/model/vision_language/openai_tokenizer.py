"""CLIP's tokenizer: byte pair encoding of lower-case text, with the merges of a file beside the weights.

Sennrich et al., "Neural machine translation of rare words with subword units" (2016). A word's last symbol is marked.
The merges are the lines of `bpe_simple_vocab_16e6.txt`, as published with CLIP, or of `merges.txt`, as published with
copies of it: two symbols each, the most frequent pair first.
"""

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput

_END_OF_WORD = "</w>"
_BYTES = 256
_SPECIAL = 2  # start and end of text: the last two tokens
_PRINTED = (*range(ord("!"), ord("~") + 1), *range(ord("¡"), ord("¬") + 1), *range(ord("®"), ord("ÿ") + 1))
_CACHE = 1 << 16
_LONGEST_WORD = 128
"""Characters of a word that are read: merging takes quadratic time."""

_WORD = re.compile(r"'(?:s|t|re|ve|m|ll|d)|[^\W\d_]+|\d|(?:[^\w\s]|_)+")


class BpeTokenizer:
    """Turns texts into tokens.

    Args:
        merges: The file's text; a first line with its version is skipped.
        tokens: Different tokens, of which the two last are start and end of text.
        length: Most tokens of a text, both included.

    Raises:
        InvalidInput: There are fewer merges than tokens, or a line is no pair.
    """

    def __init__(self, merges: str, *, tokens: int, length: int) -> None:
        self._characters = _byte_characters()
        alphabet = tuple(self._characters.values())
        count = tokens - 2 * _BYTES - _SPECIAL
        lines = merges.splitlines()
        lines = lines[1:] if lines and "#version" in lines[0] else lines
        pairs = [tuple(line.split()) for line in lines[: max(count, 0)]]
        if len(pairs) != count or any(len(pair) != 2 for pair in pairs):
            raise InvalidInput(
                f"The merges of {tokens} tokens must be {count} lines of two symbols; got {len(lines)} lines.",
                hint="Copy bpe_simple_vocab_16e6.txt or merges.txt from where the weights are from.",
            )
        symbols = [*alphabet, *(each + _END_OF_WORD for each in alphabet), *("".join(pair) for pair in pairs)]
        self._ids = {symbol: at for at, symbol in enumerate(symbols)}
        self._ranks = {pair: rank for rank, pair in enumerate(pairs)}
        self._start, self._end = tokens - 2, tokens - 1
        self._length = length
        self._word_ids = lru_cache(_CACHE)(self._merged)

    def __call__(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Returns the tokens of texts, int64 (K, `length`), zero after each end, and which were cut, bool (K,)."""
        ids = np.zeros((len(texts), self._length), np.int64)
        truncated = np.zeros(len(texts), bool)
        for row, text in enumerate(texts):
            most = self._length - _SPECIAL
            found: list[int] = []
            for word in _WORD.finditer(text.lower()):
                found += self._word_ids(word[0][:_LONGEST_WORD])
                truncated[row] |= len(word[0]) > _LONGEST_WORD or len(found) > most
                if len(found) > most:
                    break
            kept = found[:most]
            ids[row, : len(kept) + _SPECIAL] = [self._start, *kept, self._end]
        return ids, truncated

    def _merged(self, word: str) -> tuple[int, ...]:
        """Returns the tokens of a word: the pair of the lowest rank is merged until there is none."""
        *rest, last = (self._characters[byte] for byte in word.encode())
        symbols = [*rest, last + _END_OF_WORD]
        while len(symbols) > 1:
            best = min(pairwise(symbols), key=lambda pair: self._ranks.get(pair, len(self._ranks)))
            if best not in self._ranks:
                break
            symbols = list(_joined(symbols, best))
        return tuple(self._ids[each] for each in symbols)


def _byte_characters() -> dict[int, str]:
    """Returns a visible character for each byte, in the order of the vocabulary: those that are visible come first."""
    others = [byte for byte in range(_BYTES) if byte not in _PRINTED]
    return {byte: chr(byte) for byte in _PRINTED} | {byte: chr(_BYTES + at) for at, byte in enumerate(others)}


def _joined(symbols: Sequence[str], pair: tuple[str, str]) -> Iterator[str]:
    """Yields symbols with each occurrence of a pair joined, from the left."""
    at = 0
    while at < len(symbols):
        is_pair = tuple(symbols[at : at + 2]) == pair
        yield "".join(pair) if is_pair else symbols[at]
        at += 1 + is_pair
