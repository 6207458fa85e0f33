"""The order of images, as their names tell it; names that tell several series, or several orders, are refused."""

import re
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

from freerein.errors import InvalidInput

_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_TIME = re.compile(r"\d{9,}")
"""Time since the epoch in a name, in seconds: a dot after it does not separate two numbers."""

_UNITS = {10: 1, 13: 1_000, 16: 1_000_000, 19: 1_000_000_000}
"""Parts of a second that a time since the epoch counts, by its number of digits before the point."""

_MOST_UNPADDED = 7
"""Digits after the point of a time in float64; more are nanoseconds, which are padded to nine, or wrong."""

_CAMERA = re.compile(r"(?:cam|camera|kinect|realsense|view)[-_ ]?(\d{1,2})(?!\d)", re.IGNORECASE)


def in_order(files: Sequence[Path]) -> tuple[Path, ...]:
    """Returns the images of a folder in the order of the numbers, or times, in their names.

    Args:
        files: The images, in the order of their names, whole numbers in them by value.

    Raises:
        InvalidInput: Two have one number, such as `left_0.png` and `right_0.png`; some have none; they are of several
            cameras; or their names have several orders.
    """
    numbers = {each: tuple(map(Decimal, _NUMBER.findall(each.stem))) for each in files}
    _check_one_camera([each for each in files if len(numbers[each]) > 1])
    _check_all_numbered(numbers)
    texts = {_NUMBER.sub("#", each.stem) for each in files}
    shared = min(map(len, numbers.values()), default=0)  # of several texts, the further numbers mean different things
    first = dict[tuple[Decimal, ...], Path]()
    for file in files if shared else ():
        if (other := first.setdefault(numbers[file][:shared], file)) is not file:
            raise _several_series(other, file, "have the same number")
    _check_padded(files)
    ordered = tuple(sorted(files, key=lambda each: numbers[each][:shared]))
    if ordered != tuple(files) and not (len(texts) == 1 and all(_TIME.search(each.stem) for each in files)):
        raise InvalidInput(
            f"The names of the images in `{files[0].parent.name}` must have one order; as in `{files[0].name}` and "
            f"`{files[-1].name}`, they have two: of texts or whole numbers, and of decimal numbers.",
            hint="Rename them: 0001.png, 0002.png, ...",
        )
    return ordered


def times_s(files: Sequence[Path]) -> tuple[Decimal, ...]:
    """Returns the times since the epoch that images are named by, in seconds; empty where not all are named by one."""
    found = [_NUMBER.findall(each.stem) for each in files]
    whole = {len(each[0].partition(".")[0]) if len(each) == 1 else 0 for each in found}
    unit = _UNITS.get(whole.pop()) if len(whole) == 1 else None
    return tuple(Decimal(each[0]) / unit for each in found) if unit else ()


def _check_padded(files: Sequence[Path]) -> None:
    """Raises InvalidInput where nanoseconds after a point lack zeros: .5 reads as half a second then."""
    names = [each.stem for each in files if _TIME.search(each.stem)]
    parts = [number.partition(".")[2] for name in names for number in _NUMBER.findall(name)]
    lengths = {len(part) for part in parts if part}
    if len(lengths) > 1 and max(lengths) > _MOST_UNPADDED:
        raise InvalidInput(
            f"Times in the names of the images in `{files[0].parent.name}` must have one number of digits after the "
            f"point, where these are nanoseconds; they have {min(lengths)} to {max(lengths)}.",
            hint="Pad them to nine digits: 1700000000.005000000.png for 5 milliseconds.",
        )


def natural(path: Path) -> list[tuple[Decimal, str]]:
    """Returns a key that orders paths by the value of the whole numbers in them: `2.png` before `10.png`."""
    parts = re.findall(r"\d+|\D+", path.as_posix())
    return [(Decimal(part), "") if part[0].isdecimal() else (Decimal(-1), part) for part in parts]


def _check_one_camera(files: Sequence[Path]) -> None:
    cameras = {found[1]: each for each in files if (found := _CAMERA.search(each.stem))}
    if len(cameras) > 1:
        one, other, *_ = cameras.values()
        raise _several_series(one, other, "are of different cameras")


def _check_all_numbered(numbers: dict[Path, tuple[Decimal, ...]]) -> None:
    bare = next((each for each, own in numbers.items() if not own), None)
    numbered = next((each for each, own in numbers.items() if own), None)
    if bare and numbered:
        raise _several_series(bare, numbered, "have no order")


def _several_series(one: Path, other: Path, reason: str) -> InvalidInput:
    return InvalidInput(
        f"`{one.parent.name}` must hold one series of images; `{one.name}` and `{other.name}` {reason}.",
        hint="Put the images of each camera into a folder of their own, such as left/0.png and right/0.png; move "
        "copies and other pictures away.",
    )
