"""The folder of a demo: made anew, and emptied only where an earlier demo left it."""

import shutil
from pathlib import Path

from freerein.errors import FailedPrecondition, InvalidInput

MARK = ".freerein-demo"
"""The file that says of a folder, from the demo's first moment on, that the next demo may empty it."""

_SERVICES_OWN = ("datasets", "fits", "logs", "models", "runs")
_PICTURES = ("filmstrip.png", "ppo.png", "rewards.png", "timeline-blocks.png", "timeline-grid.png")
_UNMARKED = {"data", "requests", "summary.json", *_PICTURES}
_FIRST_MADE = ("requests", "data/datasets/grid-train")


def begin(out: Path, *, keep: Path | None) -> None:
    """Makes a demo's folder, empty but for the mark.

    Args:
        out: The folder.
        keep: A data directory that is to be left alone; None where there is none but the demo's own, within `out`.

    Raises:
        InvalidInput: The folder holds the data directory, or is one of those that services keep their own in.
        FailedPrecondition: It holds what no demo has left there.
    """
    folder = out.resolve()
    if keep and _is_in_the_way(folder, keep.resolve()):
        raise InvalidInput(
            "The folder for what comes out is emptied first, and must not hold the services' data directory, "
            f"nor be among what they keep there; {folder} does, or is.",
            field="out",
            hint="Choose another folder with --out.",
        )
    found = sorted(folder.iterdir()) if folder.exists() else []
    if found and not _is_a_demos(folder, found):
        raise FailedPrecondition(
            f"The folder for what comes out is emptied first, and must be new, empty, or an earlier demo's; {folder} "
            f"holds something else, such as {found[0].name}.",
            field="out",
            hint="Choose another folder with --out, or empty this one yourself.",
        )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARK).write_text("`freerein demo` made this folder, and empties it when it runs again.\n")
    for path in found:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != MARK:
            path.unlink()


def _is_in_the_way(folder: Path, data_dir: Path) -> bool:
    return data_dir.is_relative_to(folder) or any(folder.is_relative_to(data_dir / name) for name in _SERVICES_OWN)


def _is_a_demos(folder: Path, found: list[Path]) -> bool:
    """Returns whether a demo made what a folder holds; the first ones left no mark."""
    names = {path.name for path in found}
    is_all_known = names <= _UNMARKED
    return MARK in names or (is_all_known and any((folder / made).is_dir() for made in _FIRST_MADE))
