"""The size of a camera's frames, as LeRobot's datasets declare it: axes in any order, under any names or none."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from freerein.images import MAX_PIXELS, MAX_SIDE


def frame_size(feature: Mapping[str, Any]) -> tuple[int, int, int] | None:
    """Returns (H, W, C) by what tells the axes apart: the video's own size, else names, else the channels' number."""
    shape, names = feature.get("shape"), feature.get("names")
    if not isinstance(shape, list) or len(shape) not in (2, 3) or not all(map(is_length, shape)):
        return None
    lengths = [*shape, 1][:3]
    named = [str(each).lower() for each in names] if isinstance(names, list) else []
    first, second, third = lengths
    channels_last_or_first = [(first, second, third), (second, third, first)]  # LeRobot's own order is the former
    for size in (_by_video(feature), *_by_names(lengths, named), *channels_last_or_first):
        if size and sorted(size) == sorted(lengths) and size[2] in (1, 3) and size[0] * size[1] <= MAX_PIXELS:
            return size
    return None


def _by_names(lengths: Sequence[int], names: Sequence[str]) -> Iterator[tuple[int, int, int]]:
    """Yields the size where one axis is called a height and one a width, whatever the third is called."""
    high, wide = ([axis for axis, name in enumerate(names[:3]) if name[:1] == letter] for letter in "hw")
    if len(names) in (2, 3) and len(high) == len(wide) == 1:
        yield lengths[high[0]], lengths[wide[0]], lengths[3 - high[0] - wide[0]]


def _by_video(feature: Mapping[str, Any]) -> tuple[int, int, int] | None:
    """Returns the size that the encoder of a video noted; None without."""
    info = feature.get("info") or feature.get("video_info") or {}
    noted = [info.get(f"video.{name}") for name in ("height", "width", "channels")] if isinstance(info, dict) else []
    sizes = [each for each in noted if isinstance(each, int) and is_length(each)]
    return (sizes[0], sizes[1], sizes[2]) if len(sizes) == 3 else None


def is_length(value: object) -> bool:
    """Returns whether a value may be the length of an axis."""
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MAX_SIDE
