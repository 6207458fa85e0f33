"""Which child processes run a module, and how to stop one."""

from contextlib import suppress

import psutil


def children_running(module: str, parent: int | None = None) -> list[psutil.Process]:
    """Returns the children of a process (this one, if none is named) that run a module and have not ended.

    Children of children are among them, as those of a fork server are, which are told by their names.
    """
    return [child for child in psutil.Process(parent).children(recursive=True) if _runs(child, module)]


def stop(process: psutil.Process) -> None:
    """Stops a process, and returns when it has stopped."""
    process.suspend()
    while (status := process.status()) != psutil.STATUS_STOPPED:
        assert status != psutil.STATUS_ZOMBIE, f"process {process.pid} had ended before it could be stopped"


def _runs(process: psutil.Process, module: str) -> bool:
    with suppress(psutil.NoSuchProcess):  # it ended meanwhile
        is_named = process.name() == module.removeprefix("freerein_")[:15] and process.status() != psutil.STATUS_ZOMBIE
        return is_named or any(module in word for word in process.cmdline())
    return False
