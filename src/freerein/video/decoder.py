"""`python -m freerein.video.decoder FILE OPTIONS`: decodes a video; the child process of `freerein.video.reader`.

FILE is an inherited descriptor, OPTIONS the JSON of an `Options`. It writes the records of `freerein.video.records`.
"""

import io
import json
import math
import os
import resource
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from typing import Any, BinaryIO

# PyAV imports some of these only with the first container, when no file can be opened any more.
import av
import av.audio.codeccontext
import av.audio.stream
import av.logging
import av.sidedata.sidedata
import av.stream
import av.subtitles.codeccontext
import av.subtitles.stream
import numpy as np
import numpy.typing as npt
from av.error import FFmpegError
from av.video.reformatter import VideoReformatter

from freerein.video.records import CODECS, RECORD, TIME, Options

_LUMA = np.array([299, 587, 114], np.uint32)  # ITU-R BT.601, in thousandths
_LEAST_BYTES = 2**20
"""Memory without which nothing is decoded: with none at all, PyAV crashes in Python 3.12."""


class _Undecodable(Exception):
    """The file cannot be decoded; the argument is a reason of `freerein.video.refusals`."""


def main() -> None:
    """Decodes the video of the command line."""
    options = Options(**json.loads(sys.argv[2]))
    with io.FileIO(int(sys.argv[1])) as raw:
        file = io.BufferedReader(raw)
        _confine(options)
        try:
            bytearray(_LEAST_BYTES)
            for kind, *content in _records(file, options):
                _write(kind, *content)
            _write(b"E")
        except _Undecodable as error:
            _write(b"X", str(error).encode())
        except MemoryError:
            _write(b"X", b"memory")
        except (FFmpegError, ValueError):
            _write(b"X", b"corrupt")


def _confine(options: Options) -> None:
    """Lets the kernel bound this process, and keep it from opening files, sockets and further processes."""
    resource.setrlimit(resource.RLIMIT_CPU, (options.cpu_s, options.cpu_s + 1))  # SIGXCPU, and SIGKILL a second later
    for limit, most in (
        (resource.RLIMIT_AS, options.memory_bytes),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, 0),
        (resource.RLIMIT_NPROC, 0),
    ):
        resource.setrlimit(limit, (most, most))


def _records(file: BinaryIO, options: Options) -> Iterator[tuple[bytes, ...]]:
    av.logging.set_level(None)
    limits = {"max_pixels": str(options.max_pixels)}
    reformatter, size, count = VideoReformatter(), None, 0
    with av.open(file, mode="r", format="mp4", options=limits) as container:
        stream = _video_stream(container, options)
        stream.codec_context.thread_count = 1
        stream.codec_context.options = limits
        for frame in _frames(container, stream, options.start_s):
            turn = _Turn.of(frame)
            if size is None:
                size = turn.shown(frame.height, frame.width)
                yield b"I", json.dumps(_info(stream, size)).encode()
            count += 1
            _check(frame, turn.shown(frame.height, frame.width) == size, count, options)
            yield b"F", TIME.pack(frame.time or 0.0), _pixels(frame, turn, reformatter, options).tobytes()
    if not count:
        raise _Undecodable("corrupt")


def _frames(container: Any, stream: Any, start_s: float) -> Iterator[av.VideoFrame]:
    """Yields the frames from a time on, or the last one where all are before it.

    Decodes from the keyframe before that time, or from the first one where the index of the file knows none.
    """
    frames: Iterator[av.VideoFrame] = container.decode(stream)
    if start_s > 0:
        container.seek(math.floor(start_s / stream.time_base), stream=stream)
        first = next(frames, None)
        if first is None or (first.time or 0.0) > start_s:
            container.seek(0, stream=stream)
            frames = container.decode(stream)
        else:
            frames = chain([first], frames)
    before, is_due = None, False
    for frame in frames:
        is_due = is_due or (frame.time or 0.0) >= start_s
        if is_due:
            yield frame
        before = frame
    if not is_due and before is not None:
        yield before


def _video_stream(container: Any, options: Options) -> Any:
    """Returns the first video stream that is no cover picture."""
    cover = av.stream.Disposition.attached_pic
    stream = next((each for each in container.streams.video if not each.disposition & cover), None)
    if stream is None:
        raise _Undecodable("stream")
    decoder = stream.codec_context
    codec = decoder.codec.canonical_name if decoder is not None else ""
    if codec not in CODECS:
        raise _Undecodable(f"codec {codec}")
    if stream.frames > options.max_frames:
        raise _Undecodable("frames")
    if decoder.width * decoder.height > options.max_pixels:
        raise _Undecodable("pixels")
    return stream


def _check(frame: av.VideoFrame, has_size: bool, count: int, options: Options) -> None:
    if frame.is_corrupt:
        raise _Undecodable("corrupt")
    if not has_size:
        raise _Undecodable("size")
    if count > options.max_frames:
        raise _Undecodable("frames")
    if frame.height * frame.width > options.max_pixels:
        raise _Undecodable("pixels")


@dataclass(frozen=True)
class _Turn:
    """The rotation of a frame for display, by the file's display matrix.

    Rows may be shown as columns; then the order of the rows may be reversed, and that of the columns.
    """

    is_transposed: bool = False
    is_upside_down: bool = False
    is_mirrored: bool = False

    @classmethod
    def of(cls, frame: av.VideoFrame) -> "_Turn":
        """Returns the turn of a frame; an angle between quarters of a turn is rounded to the nearest."""
        data: Any = frame.side_data.get("DISPLAYMATRIX")
        if data is None:
            return cls()
        # A column x and row y of the file are shown in the column a x + c y and the row b x + d y.
        a, b, _, c, d = map(int, np.frombuffer(data, np.int32)[:5])
        if abs(b) + abs(c) > abs(a) + abs(d):
            return cls(True, b < 0, c < 0)
        return cls(False, d < 0, a < 0)

    def shown(self, height: int, width: int) -> tuple[int, int]:
        """Returns the height and width as shown of those in the file, or the reverse."""
        return (width, height) if self.is_transposed else (height, width)

    def applied(self, pixels: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Returns pixels (H, W, C) as they are shown."""
        upright = pixels.swapaxes(0, 1) if self.is_transposed else pixels
        return upright[:: -1 if self.is_upside_down else 1, :: -1 if self.is_mirrored else 1]


def _info(stream: Any, size: tuple[int, int]) -> dict[str, Any]:
    return {
        "codec": stream.codec_context.codec.canonical_name,
        "height": size[0],
        "width": size[1],
        "fps": float(stream.average_rate or Fraction(0)),
        "frame_count": stream.frames,
    }


def _pixels(
    frame: av.VideoFrame, turn: _Turn, reformatter: VideoReformatter, options: Options
) -> npt.NDArray[np.uint8]:
    """Returns a frame as it is shown, resized and with the channels asked for, uint8 (H, W, C)."""
    height, width = turn.shown(options.height, options.width)
    resized = reformatter.reformat(
        frame, width or frame.width, height or frame.height, "rgb24", interpolation="AREA", threads=1
    )
    decoded: npt.NDArray[np.uint8] = np.asarray(resized.to_ndarray(), np.uint8)
    rgb = turn.applied(decoded)  # (H, W, 3)
    if options.channels == 3:
        return rgb
    return ((rgb @ _LUMA + 500) // 1000).astype(np.uint8)[:, :, None]  # (H, W, 1)


def _write(kind: bytes, *content: bytes) -> None:
    left = memoryview(b"".join((RECORD.pack(kind, sum(map(len, content))), *content)))
    while left:
        left = left[os.write(sys.stdout.fileno(), left) :]


if __name__ == "__main__":
    main()
