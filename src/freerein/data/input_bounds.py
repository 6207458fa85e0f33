"""Bounds of frames and actions for which networks are made, as fits and `freerein dataset check` see them."""

from collections.abc import Iterator, Sequence

from freerein.types.common import ActionSpec

LEAST_SIDE, MOST_SIDE = 4, 1024
"""Pixels of a frame's height and width."""

ACTION_HINT = "Leave out numbers, or record fewer choices."

_MOST_NUMBERS, _MOST_CHOICES = 256, 4096
_SHORTER_SIDES = (96, 64, 48)


def frame_problem(size: Sequence[int]) -> str:
    """Returns what is wrong with frames of a height, a width and channels; empty where nothing is."""
    height, width, channels = size
    if all(LEAST_SIDE <= side <= MOST_SIDE for side in (height, width)) and channels in (1, 3):
        return ""
    return (
        f"Frames must be {LEAST_SIDE} to {MOST_SIDE} pixels high and wide, with 1 or 3 channels; "
        f"got {height} x {width} x {channels}."
    )


def frame_hint(size: Sequence[int]) -> str:
    """Returns how to mend frames of a wrong size."""
    smaller = next(smaller_sizes(size), None)
    scaled = f"Import frames of another size, --size {smaller[0]}x{smaller[1]}" if smaller else "Record larger frames"
    return f"{scaled}, or store them as gray or RGB."


def smaller_sizes(size: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yields heights and widths of the proportions of a frame, largest first, with which fits are usual."""
    height, width, *_ = size
    shorter = min(height, width)
    for side in _SHORTER_SIDES:
        if side < shorter:
            yield round(height * side / shorter), round(width * side / shorter)


def action_problem(action: ActionSpec) -> str:
    """Returns what is wrong with actions; empty where nothing is."""
    is_discrete = action.size == 1 and 1 <= action.choices <= _MOST_CHOICES
    if is_discrete or (0 <= action.size <= _MOST_NUMBERS and action.choices == 0):
        return ""
    return (
        f"An action must have at most {_MOST_NUMBERS} numbers, or be one of at most {_MOST_CHOICES} choices; "
        f"got {action.size} numbers and {action.choices} choices."
    )
