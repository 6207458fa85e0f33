"""BERT's uncased WordPiece tokenizer."""

import unicodedata
from collections.abc import Iterator, Sequence

MAX_TOKENS = 256
"""Tokens per text, [CLS] and [SEP] included; the rest is cut off. Sentence-transformers' number."""

_UNKNOWN, _BEGIN, _END = "[UNK]", "[CLS]", "[SEP]"
_CONTINUATION = "##"
_LONGEST_WORD = 100
_IDEOGRAPHS = (
    (0x3400, 0x4DBF),
    (0x4E00, 0x9FFF),
    (0xF900, 0xFAFF),
    (0x20000, 0x2A6DF),
    (0x2A700, 0x2CEAF),
    (0x2F800, 0x2FA1F),
)


class WordPieceTokenizer:
    """Converts texts into token ids, in time linear in their length.

    Args:
        vocabulary: Word pieces in the order of their ids; those that continue a word start with `##`.

    Raises:
        ValueError: A special token is missing.
    """

    def __init__(self, vocabulary: Sequence[str]) -> None:
        self._ids = {piece: id_ for id_, piece in enumerate(vocabulary)}
        missing = {_UNKNOWN, _BEGIN, _END} - self._ids.keys()
        if missing:
            raise ValueError(f"a vocabulary must hold {', '.join(sorted(missing))}")

    def __call__(self, text: str) -> list[int]:
        """Returns a text's token ids, [CLS] and [SEP] included, at most `MAX_TOKENS`."""
        pieces = [piece for word in _words(text) for piece in self._split(word)]
        return [self._ids[piece] for piece in (_BEGIN, *pieces[: MAX_TOKENS - 2], _END)]

    def _split(self, word: str) -> list[str]:
        """Returns a word's pieces by greedy longest match, or [UNK] when there is no match."""
        pieces, start = list[str](), 0
        while start < len(word) <= _LONGEST_WORD:
            prefix = _CONTINUATION if start else ""
            stops = range(len(word), start, -1)
            stop = next((stop for stop in stops if prefix + word[start:stop] in self._ids), None)
            if stop is None:
                break
            pieces.append(prefix + word[start:stop])
            start = stop
        return pieces if start == len(word) else [_UNKNOWN]


def _words(text: str) -> list[str]:
    """Returns a text's words and punctuation, in lower case and without accents."""
    plain = unicodedata.normalize("NFD", "".join(_cleaned(text)).lower())
    spaced = (f" {char} " if _stands_alone(char) else char for char in plain if unicodedata.category(char) != "Mn")
    return "".join(spaced).split()


def _cleaned(text: str) -> Iterator[str]:
    """Yields a text's characters without control characters, and with a blank for each kind of space."""
    for char in text:
        if char.isspace():
            yield " "
        elif unicodedata.category(char)[0] != "C" and char != "\N{REPLACEMENT CHARACTER}":
            yield char


def _stands_alone(char: str) -> bool:
    """Tells whether a character is a word: punctuation, an ASCII symbol or an ideograph."""
    if char.isascii():
        return not (char.isalnum() or char.isspace())
    return unicodedata.category(char)[0] == "P" or any(low <= ord(char) <= high for low, high in _IDEOGRAPHS)
