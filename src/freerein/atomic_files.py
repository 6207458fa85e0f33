"""Crash-safe file writes: after a crash, or on a full disk, a file is complete or absent. Errors of a full disk."""

import ctypes
import errno
import fcntl
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from freerein.errors import AlreadyExists, FailedPrecondition, OutOfStorage, Unavailable

TEMP_SUFFIX = ".tmp"
TOKEN = "[0-9a-f]" * 8
"""Glob pattern of the end of our temporary names, `secrets.token_hex(4)`: people's own hidden folders have others."""

_DELETED = ".deleted-"
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_REFUSALS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.EFBIG}
OUT_OF_FILES = frozenset({errno.EMFILE, errno.ENFILE})
"""Errors of a process, or a machine, that may open no more files."""


@contextmanager
def storage_errors(folder: str = "the data directory") -> Iterator[None]:
    """Turns the errors of a full, broken or read-only disk into `OutOfStorage`; other errors stay as they are."""
    try:
        yield
    except OSError as error:
        if error.errno not in _REFUSALS:
            raise
        raise out_of_storage(os.strerror(error.errno), folder) from error


def out_of_storage(reason: str, folder: str = "the data directory") -> OutOfStorage:
    """Returns the error of a disk that cannot be read or written, for a reason such as `No space left on device`."""
    return OutOfStorage(
        f"The disk of {folder} must work; got: {reason}.",
        hint="Free space or mend the disk; then repeat the call with the same idempotency key, or resume the fit or "
        "run that failed.",
    )


def out_of_files() -> Unavailable:
    """Returns the error of a process, or a machine, that may open no more files."""
    return Unavailable(
        "The process must have free file descriptors; all are in use.", hint="Raise its limit of open files."
    )


def write_atomic(path: Path, data: bytes) -> None:
    """Writes a file atomically: temporary file, fsync, rename, fsync of the folder. Creates missing folders.

    A file has one writer at a time: where several may write it, each holds a lock, such as `locked`.
    Raises OSError when the disk is full or broken; the temporary file is then gone.
    """
    make_folder(path.parent)
    temporary = path.with_name(path.name + TEMP_SUFFIX)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    fsync_folder(path.parent)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds the lock of a file, created when missing, which one thread of all processes has at a time."""
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def fsync_folder(folder: Path) -> None:
    """Makes renames and deletions in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yields a temporary folder beside a new one, whose name it takes once the body has ended without an error.

    Raises:
        AlreadyExists: The new one is there and not empty, or no folder.
    """
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise AlreadyExists(
            "The folder to write must be new or empty; there is something of its name.", hint="Name another folder."
        )
    temporary = folder.absolute().with_name(f".{folder.absolute().name}-{secrets.token_hex(4)}")
    make_folder(temporary)
    try:
        yield temporary
        for path in filter(Path.is_file, temporary.rglob("*")):
            with path.open("rb") as file:
                os.fsync(file.fileno())
        temporary.replace(folder)
        fsync_folder(temporary.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def delete_folder(folder: Path) -> None:
    """Deletes a folder: it is gone at once, by one rename, and then its files are.

    What a killed process left of an earlier deletion beside it is deleted, too. Needs no room on a full disk.
    """
    folder.rename(folder.with_name(f"{_DELETED}{secrets.token_hex(4)}"))
    fsync_folder(folder.parent)
    for deleted in folder.parent.glob(f"{_DELETED}{TOKEN}"):
        shutil.rmtree(deleted, ignore_errors=True)


def exchange(one: Path, other: Path) -> None:
    """Swaps two folders in one step: a process that is killed leaves each of them whole, under one of the names.

    Raises:
        FailedPrecondition: The file system cannot, such as NFS.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE):
        number = ctypes.get_errno()
        if number in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
            raise FailedPrecondition(
                "The file system must swap two folders in one step; this one cannot.",
                hint="Delete the old one first, or use a local disk.",
            )
        raise OSError(number, os.strerror(number))
    for folder in {one.parent, other.parent}:
        fsync_folder(folder)


def make_folder(folder: Path) -> None:
    """Creates a folder and its missing parents durably."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        fsync_folder(folder.parent)
