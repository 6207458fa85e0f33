"""A video of a policy, as an mp4 for people: a bounded number of frames, enlarged to be seen.

It needs PyAV (extra `video`): a run without it says so in its log, and goes on.
"""

import io
from fractions import Fraction
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.atomic_files import write_atomic
from freerein_orchestrator.kinds.context import RunContext

VIDEO = "policy.mp4"
MAX_FRAMES, _MAX_BYTES = 300, 2**28
HEIGHT = 256
_LEAST_FPS, _MOST_FPS = 1.0, 240.0
_CODEC, _PRESET = "libx264", "veryfast"
"""Half the CPU time of the codec's default, for a file a sixth larger."""

_MISSING = f"{VIDEO} is left out: it needs PyAV, which is not installed. pip install 'freerein[video]'"


def can_film(context: RunContext) -> bool:
    """Returns whether videos can be written; says in the run's log if not."""
    if find_spec("av"):
        return True
    context.log_line(_MISSING)
    return False


def max_frames(height: int, width: int) -> int:
    """Returns the most frames of a size, of three channels, that a video has: a bounded number and 256 MiB at most."""
    return max(1, min(MAX_FRAMES, _MAX_BYTES // (3 * height * width)))


def save_video(context: RunContext, frames: npt.NDArray[np.uint8], *, dt_s: float) -> None:
    """Writes an artifact, whole or not at all; says so in the run's log where PyAV cannot encode it.

    Args:
        context: The run's.
        frames: uint8 (T, H, W, C), one or three channels; those after `max_frames` are left out.
        dt_s: Seconds from one frame to the next; shown at 1 to 240 frames per second.

    Raises:
        OSError: The disk is full or broken.
    """
    import av

    fps = min(_MOST_FPS, max(_LEAST_FPS, 1 / dt_s if dt_s else _MOST_FPS))
    try:
        video = _mp4(frames[: max_frames(*frames.shape[1:3])], Fraction(fps).limit_denominator(1000))
    except (av.FFmpegError, ValueError) as error:  # as of a build without the codec; the run is worth more
        context.log_line(f"{VIDEO} is left out: PyAV cannot encode it: {error}")
    else:
        write_atomic(context.artifacts / VIDEO, video)


def _mp4(frames: npt.NDArray[np.uint8], fps: Fraction) -> bytes:
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream: Any = container.add_stream(_CODEC, rate=fps, options={"preset": _PRESET})
        stream.height, stream.width, _ = _enlarged(frames[0]).shape
        stream.pix_fmt = "yuv420p"  # which browsers show
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(_enlarged(frame), format="rgb24")))
        container.mux(stream.encode(None))
    return file.getvalue()


def _enlarged(frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Returns a frame in colour, enlarged by a whole factor, with even sides, which the codec needs."""
    factor = max(1, HEIGHT // frame.shape[0])
    large = np.broadcast_to(frame, (*frame.shape[:2], 3)).repeat(factor, axis=0).repeat(factor, axis=1)
    height, width, _ = large.shape
    return np.pad(large, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
