"""Names of skills as people write them: compared in Unicode's normal form, without regard to case and spaces."""

import unicodedata
from collections.abc import Callable, Iterable

from freerein.errors import quoted

SEPARATOR = ";"
_SEPARATORS = SEPARATOR + ",|/\\&+\t\n\r\u3001\uff0c\uff1b\uff5c\uff0f"  # and those of Chinese and Japanese
_LONGEST = 64


def normal(text: str) -> str:
    """Returns a text in Unicode's normal form C, which letters with accents have on one system and not on another."""
    return unicodedata.normalize("NFC", text.strip())


class SkillNames:
    """The spelling of each skill: the dataset's, else the first that a table has.

    Args:
        known: Skills of the dataset.
        on_note: Called with a sentence where another spelling is taken for one of them.
    """

    def __init__(self, known: Iterable[str], on_note: Callable[[str], None]) -> None:
        self._known = frozenset(known)
        self._by_key = {_key(name): name for name in sorted(self._known, reverse=True)}
        self._noted = set[str]()
        self._on_note = on_note

    def split(self, cell: str) -> list[str]:
        """Returns the skills of a cell.

        Raises:
            ValueError: It cannot be read; the text says what it must do, and what it does.
        """
        return [self.one(name) for name in cell.split(SEPARATOR)] if cell.strip() else []

    def one(self, text: str) -> str:
        """Returns the spelling of one skill; raises ValueError as `split`."""
        name = " ".join(normal(text).split())
        if name not in self._known:
            _check_apart(normal(text))
            if not 0 < len(name) <= _LONGEST or not name.isprintable():
                rule = f"hold names of 1 to {_LONGEST} printable characters, separated by `{SEPARATOR}`"
                raise ValueError(f"{rule}; got one of {len(name)}, {quoted(name)}")
            name = self._folded(name)
        return name

    def _folded(self, name: str) -> str:
        spelling = self._by_key.setdefault(_key(name), name)
        if normal(spelling) != name and name not in self._noted:
            self._noted.add(name)
            self._on_note(f"`{name}` was taken for `{spelling}`: capital letters and spaces make no difference.")
        return spelling


def _check_apart(name: str) -> None:
    separator = next((each for each in name if each in _SEPARATORS), "")
    if separator:
        shown = f"a `{separator}`" if separator.isprintable() else "a tab or a new line"
        raise ValueError(f"separate skills by `{SEPARATOR}`, such as reach;pour; it has {shown} in a name")


def _key(name: str) -> str:
    return " ".join(normal(name).casefold().split())
