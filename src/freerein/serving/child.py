"""What a child process of a service does to end with it."""

import os
import threading


def end_with_parent() -> None:
    """Ends this process at once when its standard input closes: then the service that started it is gone."""
    threading.Thread(target=_wait_and_end, name="parent", daemon=True).start()


def _wait_and_end() -> None:
    while os.read(0, 4096):  # not sys.stdin, whose lock the interpreter wants at its end
        pass
    os._exit(1)
