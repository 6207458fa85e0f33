"""What a child process of a service does to end with it."""

import os
import sys
import threading


def end_with_parent() -> None:
    """Ends this process at once when its standard input closes: then the service that started it is gone."""
    threading.Thread(target=_wait_and_end, name="parent", daemon=True).start()


def _wait_and_end() -> None:
    while sys.stdin.buffer.read(4096):
        pass
    os._exit(1)
