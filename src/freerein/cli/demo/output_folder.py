"""The demo's output folder: emptied only when an earlier demo made it."""

import shutil
from pathlib import Path

from freerein.errors import FailedPrecondition, InvalidInput

MARKER = ".freerein-demo"
"""Marker file: the next demo may empty this folder."""

_SERVICE_FOLDERS = ("datasets", "fits", "logs", "models", "named", "runs")


def prepare(out: Path, *, keep: Path) -> None:
    """Creates or empties the output folder, and writes the marker.

    Raises InvalidInput where it contains the data directory `keep` or lies in one of its service folders, and
    FailedPrecondition where something other than a demo made it.
    """
    folder = out.resolve()
    if _overlaps(folder, keep.resolve()):
        raise InvalidInput(
            "The output folder is emptied first, so it must not hold the services' data directory or lie in it; "
            f"got {folder}.",
            field="out",
            hint="Choose another folder with --out.",
        )
    found = sorted(folder.iterdir()) if folder.exists() else []
    if found and not (folder / MARKER).exists():
        raise FailedPrecondition(
            f"The output folder is emptied first, so it must be new, empty, or made by a demo; {folder} "
            f"holds other files, such as {found[0].name}.",
            field="out",
            hint="Choose another folder with --out, or empty this one yourself.",
        )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARKER).write_text("`freerein demo` made this folder and will empty it when it runs again.\n")
    for path in found:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != MARKER:
            path.unlink()


def _overlaps(folder: Path, data_dir: Path) -> bool:
    return data_dir.is_relative_to(folder) or any(folder.is_relative_to(data_dir / name) for name in _SERVICE_FOLDERS)
