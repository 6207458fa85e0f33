"""`python -m freerein.video.decoder FILE OPTIONS`: decodes a video; the child process of `freerein.video.reader`.

FILE is an inherited descriptor, OPTIONS the JSON of an `Options`. It writes the records of `freerein.video.records`.
"""

import io
import json
import os
import resource
import sys
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, BinaryIO

# PyAV imports some of these only with the first container, when no file can be opened any more.
import av
import av.audio.codeccontext
import av.audio.stream
import av.logging
import av.subtitles.codeccontext
import av.subtitles.stream
import numpy as np
import numpy.typing as npt
from av.error import FFmpegError
from av.video.reformatter import VideoReformatter

from freerein.video.records import CODECS, RECORD, TIME, Options

_LUMA = np.array([299, 587, 114], np.uint32)  # ITU-R BT.601, in thousandths
_QUARTER_DEG = 90
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
        for frame in container.decode(stream):
            if size is None:
                size = (frame.height, frame.width)
                yield b"I", json.dumps(_info(stream, frame)).encode()
            count += 1
            _check(frame, size, count, options)
            yield b"F", TIME.pack(frame.time or 0.0), _pixels(frame, reformatter, options).tobytes()
    if not count:
        raise _Undecodable("corrupt")


def _video_stream(container: Any, options: Options) -> Any:
    """Returns the first video stream."""
    if not container.streams.video:
        raise _Undecodable("stream")
    stream = container.streams.video[0]
    decoder = stream.codec_context
    if decoder is None or decoder.codec.canonical_name not in CODECS:
        raise _Undecodable("codec")
    if stream.frames > options.max_frames:
        raise _Undecodable("frames")
    if decoder.width * decoder.height > options.max_pixels:
        raise _Undecodable("pixels")
    return stream


def _check(frame: av.VideoFrame, size: tuple[int, int], count: int, options: Options) -> None:
    if frame.is_corrupt:
        raise _Undecodable("corrupt")
    if (frame.height, frame.width) != size:
        raise _Undecodable("size")
    if count > options.max_frames:
        raise _Undecodable("frames")
    if frame.height * frame.width > options.max_pixels:
        raise _Undecodable("pixels")


def _info(stream: Any, frame: av.VideoFrame) -> dict[str, Any]:
    turned = _turns(frame) % 2
    return {
        "codec": stream.codec_context.codec.canonical_name,
        "height": frame.width if turned else frame.height,
        "width": frame.height if turned else frame.width,
        "fps": float(stream.average_rate or Fraction(0)),
        "frame_count": stream.frames,
    }


def _turns(frame: av.VideoFrame) -> int:
    """Returns by how many quarters of a turn, counterclockwise, a frame is rotated to be shown."""
    return round(frame.rotation / _QUARTER_DEG)


def _pixels(frame: av.VideoFrame, reformatter: VideoReformatter, options: Options) -> npt.NDArray[np.uint8]:
    """Returns a frame upright, resized and with the channels asked for, uint8 (H, W, C)."""
    turns = _turns(frame)
    height, width = (options.width, options.height) if turns % 2 else (options.height, options.width)
    resized = reformatter.reformat(
        frame, width or frame.width, height or frame.height, "rgb24", interpolation="AREA", threads=1
    )
    rgb: npt.NDArray[np.uint8] = np.rot90(resized.to_ndarray(), turns)  # (H, W, 3)
    if options.channels == 3:
        return rgb
    return ((rgb @ _LUMA + 500) // 1000).astype(np.uint8)[:, :, None]  # (H, W, 1)


def _write(kind: bytes, *content: bytes) -> None:
    left = memoryview(b"".join((RECORD.pack(kind, sum(map(len, content))), *content)))
    while left:
        left = left[os.write(sys.stdout.fileno(), left) :]


if __name__ == "__main__":
    main()
