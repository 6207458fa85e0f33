"""Waiting for what another process or thread does."""

import time
from collections.abc import Callable


def wait_until(condition: Callable[[], object], within_s: float = 300.0) -> float:
    """Waits until a condition holds; returns how long that took, in seconds. Fails if it does not hold in time."""
    begun = time.monotonic()
    while not condition():
        waited_s = time.monotonic() - begun
        assert waited_s < within_s, "it never came true"
        time.sleep(min(0.005 + waited_s / 10, 0.1))  # to ask takes time of those that are waited for
    return time.monotonic() - begun
