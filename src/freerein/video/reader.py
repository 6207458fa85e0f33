"""A video as its reader sees it: frames that a child process decodes."""

import fcntl
import importlib.util
import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from freerein.errors import ServiceError, Unimplemented
from freerein.regular_files import regular_descriptor
from freerein.video.boxes import check_boxes
from freerein.video.records import CODECS, RECORD, TIME, Options
from freerein.video.refusals import refusal

MAX_FRAMES = 20_000
MAX_PIXELS = 4096 * 2304

_PIPE_BYTES = 2**20
_MAX_TEXT_BYTES = 1024


@dataclass(frozen=True)
class VideoBounds:
    """Bounds of one video: its frames, and the pixels of each.

    The child process has so much address space, of which a quarter of a gigabyte is code, and CPU time. The waits for
    the first frame and for the next one are at most `first_frame_s` and `silence_s`.
    """

    frames: int = MAX_FRAMES
    pixels: int = MAX_PIXELS
    memory_bytes: int = 2**30
    cpu_s: int = 120
    first_frame_s: float = 20.0
    silence_s: float = 20.0


@dataclass(frozen=True)
class VideoInfo:
    """Describes a video file: one of `CODECS`, and the height and width of its frames, upright.

    Mean frames per second, and the number of frames that it announces, are 0 when unknown.
    """

    codec: str
    height: int
    width: int
    fps: float
    frame_count: int


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame.

    Attributes:
        time_s: When it is shown, in seconds; the first one's need not be 0.
        pixels: uint8 (H, W, C), read-only.
    """

    time_s: float
    pixels: npt.NDArray[np.uint8]


class Video:
    """An open video: a context manager, and an iterator over its frames; the decoder waits while none is taken."""

    def __init__(self, file: int, options: Options, bounds: VideoBounds, *, field: str) -> None:
        self._process, self._pipe, self._held_open = _spawn(file, options)
        self._options = options
        self._bounds = bounds
        self._wait_s = bounds.first_frame_s
        self._field = field
        self._info: VideoInfo | None = None

    @property
    def info(self) -> VideoInfo:
        """Describes the file; waits for the first frame when it is asked for first, and raises as `open_video`."""
        if self._info is None:  # no `cached_property`: in Python 3.11 one video would wait for another's
            self._info = self._read_info()
            self._wait_s = self._bounds.silence_s
        return self._info

    def __iter__(self) -> Iterator[VideoFrame]:
        """Yields the frames; raises as `open_video`."""
        height, width = self._options.height or self.info.height, self._options.width or self.info.width
        shape = (height, width, self._options.channels)
        size = TIME.size + math.prod(shape)
        while (content := self._read(b"F", size, size)) is not None:
            (time_s,) = TIME.unpack_from(content)
            if not math.isfinite(time_s):
                raise self._error("corrupt")
            yield VideoFrame(time_s, np.frombuffer(content, np.uint8, offset=TIME.size).reshape(shape))

    def kill(self) -> None:
        """Ends the decoder; may be called from another thread, where an iteration then fails."""
        self._process.kill()

    def close(self) -> None:
        """Ends the decoder, waits for its end and closes the pipe."""
        self.kill()
        self._process.wait()
        self._pipe.close()
        self._held_open.close()

    def __enter__(self) -> Self:
        """Waits for the first frame; raises as `open_video`."""
        try:
            self.info  # noqa: B018  # waits
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read_info(self) -> VideoInfo:
        content = self._read(b"I", 0, _MAX_TEXT_BYTES)
        try:
            info = VideoInfo(**json.loads(content or b""))
            valid = (
                info.codec in CODECS
                and 0 < info.height * info.width <= self._options.max_pixels
                and math.isfinite(info.fps)
                and 0 <= info.frame_count <= self._options.max_frames
            )
        except (ValueError, TypeError):
            valid = False
        if not valid:
            raise self._error("corrupt")
        return info

    def _read(self, kind: bytes, least: int, most: int) -> bytes | None:
        """Returns the content of the next record, which must be of a kind and size; None at the end of the video."""
        header = self._receive(RECORD.size)
        found, size = RECORD.unpack(header)
        if found == b"E" and size == 0:
            return None
        if found == b"X" and size <= _MAX_TEXT_BYTES:
            raise self._error(self._receive(size).decode(errors="replace"))
        if found != kind or not least <= size <= most:
            raise self._error("corrupt")
        return self._receive(size)

    def _receive(self, size: int) -> bytes:
        """Returns that many bytes of the child; whatever keeps it from sending them is an error of the file."""
        received, poll = bytearray(), select.poll()
        poll.register(self._pipe, select.POLLIN)
        give_up_at = time.monotonic() + self._wait_s
        while len(received) < size:
            left_s = give_up_at - time.monotonic()
            if left_s <= 0 or not poll.poll(left_s * 1e3):
                raise self._error("silence")
            part = self._pipe.read(size - len(received))
            if not part:
                self.kill()
                raise self._error("cpu" if self._process.wait() == -signal.SIGXCPU else "corrupt")
            received += part
        return bytes(received)

    def _error(self, reason: str) -> ServiceError:
        return refusal(reason, self._options, silence_s=self._wait_s, field=self._field)


def open_video(
    source: bytes | Path,
    *,
    channels: int = 3,
    size: tuple[int, int] | None = None,
    start_s: float = 0.0,
    bounds: VideoBounds = VideoBounds(),
    field: str = "video",
) -> Video:
    """Returns a video whose decoder has begun; its frames are decoded one by one, in a `with` block.

    Args:
        source: An mp4 or mov file, or its contents.
        channels: Of the frames: 3 for RGB, 1 for gray (the luma of ITU-R BT.601).
        size: Height and width to resize frames to, whatever their aspect ratio; None to keep the file's.
        start_s: Time of the first frame wanted, in seconds; those since the last keyframe are left out.
        bounds: Bounds of the video.
        field: Name of the video in the request, for errors.

    Raises:
        UnsupportedMedia: It is neither mp4 nor mov, or of a codec that is not among `CODECS`. This and the next error
            are raised here, at the beginning of the block, or by iteration.
        InvalidInput: Corrupt, truncated, empty, no regular file, or beyond its bounds.
        Unimplemented: No decoder is installed.
    """
    if importlib.util.find_spec("av") is None:
        raise Unimplemented(
            "Reading video needs PyAV; it is not installed here.",
            field=field,
            hint="Install it where the video is read: pip install -c constraints.txt 'freerein[video]'.",
        )
    file = _opened(source, field)
    try:
        check_boxes(file, field=field)
        height, width = size or (0, 0)
        limits = (bounds.frames, bounds.pixels, bounds.memory_bytes, bounds.cpu_s)
        options = Options(channels, height, width, *limits, start_s)
        return Video(file, options, bounds, field=field)
    finally:
        os.close(file)


def _opened(source: bytes | Path, field: str) -> int:
    """Returns the descriptor of a file, or of contents in memory."""
    if isinstance(source, Path):
        return regular_descriptor(source, name=field)
    file = os.memfd_create("video")
    with FileIO(file, "wb", closefd=False) as writer:
        writer.write(source)
    return file


def _spawn(file: int, options: Options) -> "tuple[subprocess.Popen[bytes], FileIO, FileIO]":
    """Starts the decoder, without the environment of this process, which may hold its token.

    Returns its output, too, a pipe that its end closes, and what this process must hold open: its end, or that of this
    process, kills the decoder.
    """
    output, written = os.pipe()
    watched, held_open = os.pipe()
    try:
        fcntl.fcntl(output, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
        process = subprocess.Popen(
            [sys.executable, "-I", "-m", "freerein.video.decoder", str(file), options.to_json()],
            stdin=watched,
            stdout=written,
            stderr=subprocess.DEVNULL,
            pass_fds=(file,),
            env={"OPENBLAS_NUM_THREADS": "1"},
            cwd="/",
        )
        _kill_when_closed(watched, process.pid)
    except BaseException:
        os.close(output)
        os.close(held_open)
        raise
    finally:
        os.close(written)
        os.close(watched)
    return process, FileIO(output), FileIO(held_open, "wb")


def _kill_when_closed(pipe: int, pid: int) -> None:
    """Lets the kernel kill a process, whose standard input is the end of a pipe, once the other end is closed."""
    fcntl.fcntl(pipe, fcntl.F_SETOWN, pid)
    fcntl.fcntl(pipe, fcntl.F_SETSIG, signal.SIGKILL)  # in place of SIGIO
    fcntl.fcntl(pipe, fcntl.F_SETFL, os.O_ASYNC)
