"""Frames of a video at a rate of one's own: what it shows at each time, whatever its own rate."""

from collections.abc import Iterable, Iterator
from itertools import count

from freerein.errors import InvalidInput
from freerein.video.reader import VideoFrame

_ROUNDING_S = 1e-3
"""By how much a frame may begin after a timestep that shows it: files have times in milliseconds, or finer ones."""

_LONGEST_GAP_S = 60.0
"""Between two frames; broken time stamps have longer ones."""


def frames_at_rate(video: Iterable[VideoFrame], *, fps: float, file: str) -> Iterator[VideoFrame]:
    """Yields the frame that a video shows at each time 0, 1 / fps, ... since its first, to its last; with that time.

    A frame is repeated while the next one is not due, and left out where others are shown before and after it.

    Args:
        video: Its frames, at least one.
        fps: Timesteps per second.
        file: Name of the video, for errors.

    Raises:
        InvalidInput: There is no frame for more than a minute.
    """
    frames = iter(video)
    shown = first = next(frames)
    following = next(frames, None)
    for index in count():
        time_s = first.time_s + index / fps
        while following is not None and following.time_s <= time_s + _ROUNDING_S:
            shown, following = following, next(frames, None)
        if following is None and time_s > shown.time_s + _ROUNDING_S:
            return
        if following is not None and following.time_s - shown.time_s > _LONGEST_GAP_S:
            raise InvalidInput(
                f"`{file}` must have a frame at least every {_LONGEST_GAP_S:g} s; after {shown.time_s:.3f} s there is "
                f"none until {following.time_s:.3f} s.",
                hint="Cut it, or give it times again: ffmpeg -i IN -vf setpts=N/FPS/TB -c:v libx264 OUT.mp4.",
            )
        yield VideoFrame(time_s, shown.pixels)
