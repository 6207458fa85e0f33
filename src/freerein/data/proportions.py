"""Whether frames are stretched: scaled to other proportions than their own."""

from collections.abc import Mapping

_ROUNDING = 1.03
"""Ratio of proportions up to which they count as one, such as those of 1080 x 1920 and 96 x 170."""


def are_stretched(shape: tuple[int, ...], size: tuple[int, int]) -> bool:
    """Returns whether frames (H, W, ...) have other proportions than a height and width; rounding is allowed."""
    ratio = shape[0] * size[1] / (shape[1] * size[0])
    return not 1 / _ROUNDING <= ratio <= _ROUNDING


def stretch_notes(stretched: Mapping[str, tuple[int, ...]], size: tuple[int, int] | None) -> tuple[str, ...]:
    """Returns a sentence about frames, by name, that are stretched from a height and width to `size`; none without."""
    if not stretched or size is None:
        return ()
    name, (height, width) = next(iter(stretched.items()))
    others = f" and those of {len(stretched) - 1} others" if len(stretched) > 1 else ""
    return (
        f"Frames of `{name}`, {height} x {width},{others} were stretched to {size[0]} x {size[1]}, of other "
        "proportions: crop or turn them first.",
    )
