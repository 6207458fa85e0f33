"""Ids of runs and fits, which people shorten as the command line does."""

import re
from collections.abc import Sequence

from freerein.errors import InvalidInput

_ID_DIGITS, _SHOWN = 32, 8


def short(job_id: str) -> str:
    """Returns the first digits of an id, which name it in every command."""
    return job_id[:_SHOWN]


def is_whole_id(given: str) -> bool:
    """Returns whether this is an id, neither its first digits nor a readable name."""
    return re.fullmatch(rf"[0-9a-f]{{{_ID_DIGITS}}}", given) is not None


def whole_id(given: str, ids: Sequence[str], *, list_command: str) -> str:
    """Returns the one id that begins with the digits given, or with those at the end of a readable name.

    Raises InvalidInput where none or several do.
    """
    digits = given.rpartition("-")[2]
    found = [each for each in ids if digits and each.startswith(digits)]
    if len(found) != 1:
        raise InvalidInput(
            f"An id of {_ID_DIGITS} digits, or its first ones, must be given; {len(found)} ids begin so.",
            field="id",
            hint=f"`{list_command}` shows all.",
        )
    return found[0]
