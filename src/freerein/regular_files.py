"""Files that people bring, opened only where they are regular: a pipe keeps its reader waiting, a device never ends."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from freerein.errors import InvalidInput

TABLE_BYTES = 2**26
"""Most bytes of a table, a description or an image."""

_NO_WAITING = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC  # to open a pipe waits until somebody writes to it
_KINDS = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}


def open_regular(path: Path, *, name: str) -> BufferedReader:
    """Returns a regular file, opened for reading; raises as `regular_descriptor`."""
    return os.fdopen(regular_descriptor(path, name=name), "rb")


def read_regular(path: Path, *, name: str, most_bytes: int = TABLE_BYTES) -> bytes:
    """Returns the contents of a regular file.

    Args:
        path: The file.
        name: Its name in errors.
        most_bytes: Most bytes that it may have.

    Raises:
        InvalidInput: It has more, or as `regular_descriptor`.
        OSError: It is missing, or may not be read.
    """
    with open_regular(path, name=name) as file:
        if os.fstat(file.fileno()).st_size > most_bytes:
            raise InvalidInput(
                f"`{name}` must have at most {most_bytes >> 20} MiB; it has more.", hint="Split it, or leave it out."
            )
        return file.read()


def regular_descriptor(path: Path, *, name: str) -> int:
    """Returns the descriptor of a regular file, or of one that a link leads to, opened for reading.

    Args:
        path: The file.
        name: Its name in errors.

    Raises:
        InvalidInput: It is a pipe, a device, a socket or a folder.
        OSError: It is missing, or may not be read.
    """
    try:
        file = os.open(path, os.O_RDONLY | _NO_WAITING)
    except OSError as error:
        if error.errno != errno.ENXIO:
            raise
        raise _irregular(name, stat.S_IFSOCK) from None
    kind = stat.S_IFMT(os.fstat(file).st_mode)
    if kind != stat.S_IFREG:
        os.close(file)
        raise _irregular(name, kind)
    return file


def _irregular(name: str, kind: int) -> InvalidInput:
    return InvalidInput(
        f"`{name}` must be a regular file; it is {_KINDS.get(kind, 'something else')}.",
        hint="Replace it by a copy of its contents, or leave it out.",
    )
