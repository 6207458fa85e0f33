"""How much memory a process has taken."""

import threading
from typing import Any


class Growth:
    """The most memory that a process has held beyond what it held before, in bytes."""

    def __init__(self, process: Any) -> None:
        self._process = process
        self._done = threading.Event()
        self._before = process.memory_info().rss
        self.most = 0

    def __enter__(self) -> "Growth":
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._done.wait(0.005):
            self.most = max(self.most, self._process.memory_info().rss - self._before)
