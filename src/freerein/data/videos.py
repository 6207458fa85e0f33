"""Frames of trajectories in video files: one to a file, or several, as LeRobot stores them; stretched ones."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.video import Video, VideoBounds, VideoFrame, open_video

BOUNDS = VideoBounds(frames=10_000_000, memory_bytes=2**31, cpu_s=86_400, silence_s=60.0)
"""Bounds of a file that the user chose, which may hold hours: wider than for a request, and still bounded."""

_TOLERANCE = 0.25
"""Tolerance of time stamps, as a share of the time between frames: they are sums of rounded numbers."""

_ROUNDING = 1.03
"""Ratio of proportions up to which they count as one, such as those of 1080 x 1920 and 96 x 170."""


@dataclass(frozen=True)
class VideoSpan:
    """Where the frames of one trajectory and camera lie.

    Attributes:
        root: Folder of the dataset.
        file: The video file, relative to it.
        start_s: Time of the first frame in the file, in seconds; frame i follows after i / fps.
        length: Number of frames.
    """

    root: Path
    file: str
    start_s: float
    length: int

    def part(self, frames: range, fps: int) -> Self:
        """Returns where some frames of it lie, at so many per second."""
        return replace(self, start_s=self.start_s + frames.start / fps, length=len(frames))


def video_frames(
    spans: Sequence[VideoSpan], *, fps: int, size: tuple[int, int, int], declared: tuple[int, int]
) -> Iterator[npt.NDArray[np.uint8]]:
    """Yields the frames of each span, uint8 (T, H, W, C); each file is decoded once where spans are in its order.

    Args:
        spans: Where they lie.
        fps: Frames per second.
        size: (H, W, C) to scale them to.
        declared: Height and width of the dataset's frames; a file may have others of these proportions.

    Raises:
        InvalidInput: A file is missing or corrupt, has other proportions, or lacks a frame at one of the times.
        UnsupportedMedia: As `open_video`.
        Unimplemented: No decoder is installed.
    """
    with ExitStack() as opened:
        current, position_s, frames = "", 0.0, iter(tuple[VideoFrame]())
        for span in spans:
            if span.file != current or span.start_s <= position_s:
                opened.close()
                video = opened.enter_context(_open(span, size, fps))
                _check_proportions(video, declared, span.file)
                frames, current = iter(video), span.file
            found = np.empty((span.length, *size), np.uint8)
            for index, frame in enumerate(_at_times(frames, span, fps)):
                found[index], position_s = frame.pixels, frame.time_s
            yield found


def joined(frames: Iterable[npt.NDArray[np.uint8]], size: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """Returns frames of one size as one array, uint8 (T, H, W, C), without holding them twice, as `np.stack` does."""
    pixels = bytearray()
    for frame in frames:
        pixels += frame.tobytes()
    return np.frombuffer(pixels, np.uint8).reshape(-1, *size)


def check_length(span: VideoSpan, end_s: float, *, index: int, fps: int) -> VideoSpan:
    """Returns a span whose time to `end_s` is that of its frames; raises InvalidInput for another."""
    if not abs((end_s - span.start_s) * fps - span.length) < 0.5:  # False for NaN
        raise InvalidInput(
            f"Trajectory {index} must last as long in its video as its {span.length} timesteps at {fps} per second; "
            f"`{span.file}` has it for {end_s - span.start_s:.3f} s.",
            hint="Open the dataset in LeRobot: its episodes table and its videos do not belong together.",
        )
    return span


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


def _open(span: VideoSpan, size: tuple[int, int, int], fps: int) -> Video:
    path, start_s = span.root / span.file, max(0.0, span.start_s - _TOLERANCE / fps)
    try:
        return open_video(path, channels=size[2], size=size[:2], start_s=start_s, bounds=BOUNDS, field=span.file)
    except FileNotFoundError:
        raise InvalidInput(
            f"The video `{span.file}` must be in the dataset; it is missing.", hint="Restore it from a copy."
        ) from None


def _check_proportions(video: Video, declared: tuple[int, int], file: str) -> None:
    own = (video.info.height, video.info.width)
    if are_stretched(own, declared):
        raise InvalidInput(
            f"`{file}` must have frames of the proportions that the dataset declares, {declared[0]} x {declared[1]}; "
            f"they are {own[0]} x {own[1]}.",
            hint="Turn or crop the video, or write the dataset again with LeRobot.",
        )


def _at_times(frames: Iterator[VideoFrame], span: VideoSpan, fps: int) -> Iterator[VideoFrame]:
    """Yields the frames of a span; those before it are skipped."""
    tolerance_s = _TOLERANCE / fps
    for index in range(span.length):
        time_s = span.start_s + index / fps
        frame = next((each for each in frames if each.time_s >= time_s - tolerance_s), None)
        if frame is None or frame.time_s > time_s + tolerance_s:
            found = "the video ends before" if frame is None else f"the next one is at {frame.time_s:.3f} s"
            raise InvalidInput(
                f"`{span.file}` must have a frame at {time_s:.3f} s, number {index} of {span.length} of a trajectory; "
                f"{found}.",
                hint="Its frames must be evenly spaced, as many as the trajectory's rows; encode the dataset again.",
            )
        yield frame
