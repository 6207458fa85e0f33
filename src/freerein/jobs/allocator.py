"""The allocator of a job's child process."""

import ctypes
from contextlib import suppress

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX = -1, -2, -4  # of glibc's malloc.h
_TOP_PAD_BYTES = 500_000_000


def keep_freed_memory() -> None:
    """Makes glibc keep the memory that this process frees, and take it from the kernel in large parts.

    By default glibc returns arrays above 32 MB to the kernel as soon as they are freed, and each optimiser update pays
    for new pages. Changes nothing where the C library has no `mallopt`.
    """
    with suppress(AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_MAX, 0)
        mallopt(_TRIM_THRESHOLD, -1)
        mallopt(_TOP_PAD, _TOP_PAD_BYTES)
