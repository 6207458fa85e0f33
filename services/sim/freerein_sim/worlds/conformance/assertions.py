"""Assertions of checks, as sentences."""

from collections.abc import Callable

from freerein.errors import InvalidInput


def require(holds: bool, sentence: str) -> None:
    """Raises AssertionError with the sentence unless it holds."""
    if not holds:
        raise AssertionError(f"Expected: {sentence}")


def require_refusal(call: Callable[[], object], sentence: str) -> None:
    """Raises AssertionError with the sentence unless the call raises InvalidInput."""
    try:
        call()
    except InvalidInput:
        return
    raise AssertionError(f"Expected: {sentence}")
