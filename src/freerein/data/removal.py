"""Deletes datasets, and what can be made again: decoded frames, and what killed processes left."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from freerein.atomic_files import TOKEN, delete_folder, exchange
from freerein.data import labels, layout
from freerein.data.cache import delete_cached, unused_folders
from freerein.data.folder_locks import unused
from freerein.data.meta import WriterLock
from freerein.errors import FailedPrecondition, NotFound, quoted

_TEMPORARY = (".copy-", ".create-", ".deleted-", ".import-", ".record-")
"""Prefixes of `temporary_folder` and `delete_folder`."""


def delete(root: Path) -> None:
    """Deletes a dataset, damaged or not; of a link to a dataset elsewhere, the link.

    Raises:
        NotFound: There is none.
        FailedPrecondition: A process is writing it.
    """
    with _unwritten(root):
        if root.is_symlink():
            root.unlink()
        else:
            delete_folder(root)


def replace(root: Path, new: Path, *, check_unused: Callable[[], object]) -> None:
    """Puts a new dataset in the place of another, which takes the new one's; raises as `delete` and `exchange`.

    `check_unused` is called just before, and raises where the other one must stay.
    """
    with _unwritten(root):
        check_unused()
        exchange(root, new)


def prune(datasets: Path) -> int:
    """Deletes the decoded frames of all datasets, and what killed processes left; returns the bytes of it.

    A fit that reads decoded frames goes on: their space is free when it ends. Those being made stay, and so do files
    and folders that freerein did not name, and what links lead to.
    """
    freed = 0
    for cache in datasets.glob("*/cache"):
        root = cache.parent
        if (root / layout.INFO_FILE).is_file() and not (root.is_symlink() or cache.is_symlink()):
            freed += sum(map(delete_cached, unused_folders(cache)))
    left = (each for prefix in _TEMPORARY for each in datasets.glob(prefix + TOKEN) if not each.is_symlink())
    for folder in unused(left):
        freed += sum(file.lstat().st_size for file in folder.rglob("*"))
        shutil.rmtree(folder, ignore_errors=True)
    return freed


@contextmanager
def _unwritten(root: Path) -> Iterator[None]:
    """Keeps writers of a dataset and of its labels out; a link goes without a look at where it leads."""
    if not root.is_symlink() and not root.is_dir():
        raise NotFound(
            f"The dataset must be in the data directory; got {quoted(root.name)}.",
            field="dataset",
            hint="`freerein dataset list` names all.",
        )
    with ExitStack() as held:
        for folder in () if root.is_symlink() else (root, root / labels.FOLDER):
            if folder.is_dir():
                held.enter_context(closing(_locked(folder, root.name)))
        yield


def _locked(folder: Path, name: str) -> WriterLock:
    try:
        return WriterLock(folder)
    except FailedPrecondition:
        raise FailedPrecondition(
            f"The dataset {name} must not be in use; a process writes it.", field="dataset", hint="Wait for its end."
        ) from None
