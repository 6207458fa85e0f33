"""Names that callers wrote and nobody knows: quoted in errors, beside the known name that was probably meant.

A caller may read its own names, short and printable; never its values, nor names of others.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence

MAX_QUOTED = 64
"""Characters of the longest name that is quoted."""

_MAX_LISTED = 8
_CUTOFF = 0.75  # 0 to 1; at 0.6, difflib's own, `frames` would be taken for `name`


def quoted_name(name: str) -> str:
    """Returns a name in backquotes, or its length where it is no short, printable name."""
    if 0 < len(name) <= MAX_QUOTED and name.isprintable() and "`" not in name:
        return f"`{name}`"
    return f"a name of {len(name)} characters"


def described(name: str, known: Iterable[str], meanings: Mapping[str, str] | None = None) -> str:
    """Returns a name, quoted, and the known one that was probably meant, as a part of a sentence with its end.

    Args:
        name: What the caller wrote.
        known: Names that there are; those of parts may have dots or slashes before them.
        meanings: Names of other programs, and what they are here.
    """
    meant = (meanings or {}).get(name) or nearest(name, known)
    return f"{quoted_name(name)}; did you mean `{meant}`?" if meant else f"{quoted_name(name)}."


def listed(names: Sequence[str]) -> str:
    """Returns names, quoted, the first few of them."""
    more = [f"{len(names) - _MAX_LISTED} more"] if len(names) > _MAX_LISTED else []
    return ", ".join([*map(quoted_name, names[:_MAX_LISTED]), *more])


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Returns the known name that is closest, whatever its case and separators; None where none is close."""
    names = list(known)
    spelled = {_letters(_last_part(each)): each for each in reversed(names)}
    spelled |= {_letters(each): each for each in reversed(names)}
    written = _letters(name[:MAX_QUOTED])
    close = [written] if written in spelled else difflib.get_close_matches(written, spelled, n=1, cutoff=_CUTOFF)
    return spelled[close[0]] if close and written else None


def _last_part(name: str) -> str:
    return name.replace("/", ".").rpartition(".")[2]


def _letters(name: str) -> str:
    return "".join(character for character in name.casefold() if character.isalnum())
