"""The wall clock, which says when things happened. It may jump: nothing waits by it, and only this file reads it."""

import time


def now_ns() -> int:
    """Returns the Unix time in nanoseconds."""
    return time.time_ns()
