"""The allocator of services and of the child processes of jobs."""

import ctypes
import threading
import time
from collections.abc import Callable

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX = -1, -2, -4  # of glibc's malloc.h
_TOP_PAD_BYTES = 500_000_000
_KEPT_S = 60.0


def keep_freed_memory(*, kept_s: float = _KEPT_S) -> None:
    """Makes glibc keep the memory that this process frees, and return it to the kernel once in `kept_s` seconds.

    By default glibc returns large arrays as soon as they are freed, and each optimiser update or model call pays for
    new pages. If freed memory were never returned, arrays of ever different sizes would leave ever more gaps: an
    encoder that was trained on batches of many lengths had five times what it used. Changes nothing where the C library
    has no `mallopt`.
    """
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallopt"):
        return
    libc.mallopt(_MMAP_MAX, 0)
    libc.mallopt(_TRIM_THRESHOLD, -1)
    libc.mallopt(_TOP_PAD, _TOP_PAD_BYTES)
    threading.Thread(target=_return, args=(libc.malloc_trim, kept_s), name="allocator", daemon=True).start()


def _return(malloc_trim: Callable[[int], int], kept_s: float) -> None:
    while True:
        time.sleep(kept_s)
        malloc_trim(0)
