"""Frames of a request's video, a few at a time: a video is never in memory as a whole."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein.serving.limits import Slots
from freerein.types.common import Camera
from freerein.video import VideoBounds, VideoFrame, frames_at_rate, open_video

T = TypeVar("T")

_PIXELS_AT_ONCE = 2**21
_MAX_FRAMES_AT_ONCE = 256
_BOUNDS = VideoBounds(first_frame_s=10.0)


@dataclass(frozen=True, eq=False)
class VideoChunk:
    """Consecutive frames.

    Attributes:
        frames: uint8 (n, H, W, C).
        time_s: float32 (n,), when each is shown, in seconds.
    """

    frames: npt.NDArray[np.uint8]
    time_s: npt.NDArray[np.float32]


class VideoDecoding:
    """Decodes videos, on threads of its own: at most `videos` at once, each in a child process.

    A caller that leaves ends its decoder at once. Its call ends, and its place is free, when its thread is.
    """

    def __init__(self, videos: int) -> None:
        self._slots = Slots(videos, "videos may be decoded")
        self._threads = ThreadPoolExecutor(videos, "video")

    async def frames(
        self, data: bytes, camera: Camera, *, resize: bool, fps: float = 0.0
    ) -> AsyncGenerator[VideoChunk, None]:
        """Yields the frames of an mp4 or mov file as a camera's, resized to its size only when asked.

        They are those shown `fps` times per second; all of them where `fps` is 0.

        Raises:
            InvalidInput: The video has another size than the camera, or as `open_video`.
            Overloaded: Too many videos are being decoded.
            UnsupportedMedia, Unimplemented: As `open_video`.
        """
        size = (camera.height, camera.width)
        asked = size if resize else None
        with self._slots.hold():
            starting = self._run(lambda: open_video(data, channels=camera.channels, size=asked, bounds=_BOUNDS))
            try:
                video = await _end_of(starting)
                await _end_of(self._run(lambda: video.info), stop=video.kill)
                if not resize and (video.info.height, video.info.width) != size:
                    raise _other_size((video.info.height, video.info.width), size)
                at_once = max(1, min(_MAX_FRAMES_AT_ONCE, _PIXELS_AT_ONCE // (camera.height * camera.width)))
                frames = frames_at_rate(video, fps=fps, file="video") if fps else iter(video)
                while chunk := await _end_of(self._run(lambda: _take(frames, at_once)), stop=video.kill):
                    yield chunk
            finally:
                if starting.exception() is None:
                    await _end_of(self._run(starting.result().close))

    def _run(self, work: Callable[[], T]) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(self._threads, work)


async def _end_of(work: "asyncio.Future[T]", *, stop: Callable[[], None] = lambda: None) -> T:
    """Returns the result of a thread's work. A caller that leaves stops it, and waits for its end, too."""
    cancelled: asyncio.CancelledError | None = None
    while not work.done():
        try:
            await asyncio.wait({work})
        except asyncio.CancelledError as error:
            cancelled = error
            stop()
    if cancelled is not None:
        work.exception()  # is nobody's any more
        raise cancelled
    return work.result()


def _take(frames: Iterator[VideoFrame], most: int) -> VideoChunk | None:
    """Returns the next frames, None at the end of the video."""
    taken = list(islice(frames, most))
    if not taken:
        return None
    return VideoChunk(
        np.stack([frame.pixels for frame in taken]), np.array([frame.time_s for frame in taken], np.float32)
    )


def _other_size(found: tuple[int, int], expected: tuple[int, int]) -> InvalidInput:
    return InvalidInput(
        f"Frames of `video` must have the model's height and width, {expected[0]} x {expected[1]}; "
        f"got {found[0]} x {found[1]}.",
        field="video",
        hint="Scale the video, or set `resize`, which ignores its aspect ratio.",
    )
