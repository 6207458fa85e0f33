"""Which child processes run a module."""

from contextlib import suppress

import psutil


def children_running(module: str, parent: int | None = None) -> list[psutil.Process]:
    """Returns the children of a process (this one, if none is named) that run a module and have not ended."""
    return [child for child in psutil.Process(parent).children() if _runs(child, module)]


def _runs(process: psutil.Process, module: str) -> bool:
    with suppress(psutil.NoSuchProcess):  # it ended meanwhile
        return any(module in word for word in process.cmdline())
    return False
