"""Texts to whole numbers as BERT reads them: lower case, no accents, and the longest pieces of words that it knows."""

import unicodedata
from collections.abc import Iterator, Sequence

MAX_TOKENS = 256
"""Of a text, its two ends included; what is beyond is not read. Sentence-transformers' number."""

_UNKNOWN, _BEGIN, _END = "[UNK]", "[CLS]", "[SEP]"
_CONTINUED = "##"
_LONGEST_WORD = 100
_IDEOGRAPHS = (
    (0x3400, 0x4DBF),
    (0x4E00, 0x9FFF),
    (0xF900, 0xFAFF),
    (0x20000, 0x2A6DF),
    (0x2A700, 0x2CEAF),
    (0x2F800, 0x2FA1F),
)


class WordPieces:
    """Splits texts into pieces of words, in time linear in their length.

    Args:
        vocabulary: The pieces, in the order of their numbers; those that continue a word begin with `##`.

    Raises:
        ValueError: One of BERT's own signs is missing.
    """

    def __init__(self, vocabulary: Sequence[str]) -> None:
        self._numbers = {piece: number for number, piece in enumerate(vocabulary)}
        missing = {_UNKNOWN, _BEGIN, _END} - self._numbers.keys()
        if missing:
            raise ValueError(f"a vocabulary must hold {', '.join(sorted(missing))}")

    def __call__(self, text: str) -> list[int]:
        """Returns a text's pieces as numbers, its begin and end included, at most `MAX_TOKENS`."""
        pieces = [piece for word in _words(text) for piece in self._split(word)]
        return [self._numbers[piece] for piece in (_BEGIN, *pieces[: MAX_TOKENS - 2], _END)]

    def _split(self, word: str) -> list[str]:
        """Returns the longest known pieces of a word from its front on; the unknown sign where there are none."""
        pieces, start = list[str](), 0
        while start < len(word) <= _LONGEST_WORD:
            prefix = _CONTINUED if start else ""
            stops = range(len(word), start, -1)
            stop = next((stop for stop in stops if prefix + word[start:stop] in self._numbers), None)
            if stop is None:
                break
            pieces.append(prefix + word[start:stop])
            start = stop
        return pieces if start == len(word) else [_UNKNOWN]


def _words(text: str) -> list[str]:
    """Returns a text's words and its other signs one by one."""
    plain = unicodedata.normalize("NFD", "".join(_cleaned(text)).lower())
    spaced = (f" {sign} " if _stands_alone(sign) else sign for sign in plain if unicodedata.category(sign) != "Mn")
    return "".join(spaced).split()


def _cleaned(text: str) -> Iterator[str]:
    """Yields the signs of a text, without those that cannot be seen, and with a blank for each kind of space."""
    for sign in text:
        if sign.isspace():
            yield " "
        elif unicodedata.category(sign)[0] != "C" and sign != "\N{REPLACEMENT CHARACTER}":
            yield sign


def _stands_alone(sign: str) -> bool:
    """Tells whether a sign is a word: punctuation, any ASCII sign that is no letter or digit, or an ideograph."""
    if sign.isascii():
        return not (sign.isalnum() or sign.isspace())
    return unicodedata.category(sign)[0] == "P" or any(low <= ord(sign) <= high for low, high in _IDEOGRAPHS)
