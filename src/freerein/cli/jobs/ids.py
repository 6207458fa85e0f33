"""Ids of runs and fits, which people shorten as the command line does."""

import re
from collections.abc import Iterable

from freerein.errors import InvalidInput

_ID_DIGITS, _SHOWN, _LEAST_BY_NAME = 32, 8, 6


def short(job_id: str) -> str:
    """Returns the first digits of an id, which name it in every command."""
    return job_id[:_SHOWN]


def is_whole_id(given: str) -> bool:
    """Returns whether this is an id, neither its first digits nor a readable name."""
    return re.fullmatch(rf"[0-9a-f]{{{_ID_DIGITS}}}", given) is not None


def matching(given: str, ids: Iterable[str]) -> list[str]:
    """Returns the ids that begin with these digits, or with those, at least 6, that a readable name ends with.

    A name alone is no id: that of another job may end in digits, such as `segmentation-kitchen-2`.
    """
    name, _, digits = given.rpartition("-")
    is_enough = len(digits) >= (_LEAST_BY_NAME if name else 1)
    return [each for each in ids if is_enough and each.startswith(digits)]


def whole_id(given: str, ids: Iterable[str]) -> str:
    """Returns the id that is meant by first digits or a readable name; raises InvalidInput for none, or several."""
    found = matching(given, ids)
    if len(found) != 1:
        raise InvalidInput(
            f"An id of {_ID_DIGITS} digits, or its first ones, must be given, or a name that ends in {_LEAST_BY_NAME} "
            f"of them; {len(found)} ids begin so.",
            field="id",
            hint="`freerein jobs list` shows all.",
        )
    return found[0]
