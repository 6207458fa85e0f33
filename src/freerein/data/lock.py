"""The lock that keeps a dataset to one writer."""

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from freerein.errors import FailedPrecondition


class WriterLock:
    """Held by the one process that may write to a dataset; the kernel frees it when that process dies.

    Raises:
        FailedPrecondition: Someone else holds it.
    """

    def __init__(self, root: Path) -> None:
        self._descriptor = os.open(root / "writer.lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._descriptor)
            raise FailedPrecondition(
                "A dataset has one writer at a time; this one is being written by another.",
                hint="Close the other writer, or write to another dataset.",
            ) from None

    def release(self) -> None:
        """Lets others write. To release twice is an error."""
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.release()
