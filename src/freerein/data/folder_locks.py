"""Locks of folders in the making, which tell what a killed process left behind from what another one is writing.

The kernel releases the lock of a process that dies, however it dies.
"""

import fcntl
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from freerein.atomic_files import TOKEN


@contextmanager
def temporary_folder(parent: Path, *, prefix: str) -> Iterator[Path]:
    """Makes a folder that is deleted in the end, and deletes those of the same prefix that killed processes left."""
    for abandoned in unused(parent.glob(f"{prefix}{TOKEN}")):
        shutil.rmtree(abandoned, ignore_errors=True)
    with in_use(parent / f"{prefix}{secrets.token_hex(4)}") as folder:
        try:
            yield folder
        finally:
            shutil.rmtree(folder)


@contextmanager
def in_use(folder: Path) -> Iterator[Path]:
    """Makes a folder where it is missing, and keeps it out of `unused`; several processes may do so at once."""
    descriptor = _locked(folder)
    try:
        yield folder
    finally:
        os.close(descriptor)


def unused(folders: Iterable[Path]) -> Iterator[Path]:
    """Yields those folders that no process has in use; none can until the next folder is asked for."""
    for folder in folders:
        descriptor = _locked_alone(folder)
        if descriptor is not None:
            try:
                yield folder
            finally:
                os.close(descriptor)


def _locked(folder: Path) -> int:
    """Returns a descriptor that shares the lock of a folder, made again where another process is deleting it."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError), ExitStack() as closing:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            closing.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_SH)
            if os.path.samestat(os.fstat(descriptor), folder.stat()):
                closing.pop_all()
                return descriptor


def _locked_alone(folder: Path) -> int | None:
    """Returns a descriptor that alone has the lock of a folder; None where the folder is in use, gone or unreadable."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
