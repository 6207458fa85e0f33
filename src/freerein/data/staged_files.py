"""Files of a folder of other programs that are replaced together: written beside the old ones first, then renamed."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from freerein.atomic_files import TEMP_SUFFIX, fsync_folder


@contextmanager
def staged_files() -> Iterator[Callable[[Path], Path]]:
    """Yields a function that returns where the new contents of a file are to be written; renames all in the end.

    New files have the permissions of those that they replace.
    Where the body fails, as on a full disk, all files are as before. A process that is killed while they are renamed,
    which takes milliseconds, leaves some new and some old ones, each of them whole.
    """
    staged = dict[Path, Path]()

    def stage(path: Path) -> Path:
        staged[path] = path.with_name(path.name + TEMP_SUFFIX)
        return staged[path]

    try:
        yield stage
        for path, temporary in staged.items():
            if path.exists():
                shutil.copymode(path, temporary)
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
    except BaseException:
        for temporary in staged.values():
            if temporary.is_file():
                temporary.unlink()
        raise
    for path, temporary in staged.items():
        temporary.replace(path)
    for folder in {path.parent for path in staged}:
        fsync_folder(folder)
