"""What a policy does, as an mp4 for people: a bounded number of frames, enlarged to be seen.

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
MAX_FRAMES = 300
_HEIGHT = 256
_CODEC = "libx264"
_MISSING = f"{VIDEO} is left out: it needs PyAV, which is not installed. pip install 'freerein[video]'"


def can_film(context: RunContext) -> bool:
    """Returns whether videos can be written; says in the run's log if not."""
    if find_spec("av"):
        return True
    context.log_line(_MISSING)
    return False


def save_video(context: RunContext, frames: npt.NDArray[np.uint8], *, dt_s: float) -> None:
    """Writes an artifact, whole or not at all.

    Args:
        context: The run's.
        frames: uint8 (T, H, W, C), one or three channels; those after `MAX_FRAMES` are left out.
        dt_s: Seconds from one frame to the next.

    Raises:
        OSError: The disk is full or broken.
    """
    write_atomic(context.artifacts / VIDEO, _mp4(_enlarged(frames[:MAX_FRAMES]), dt_s))


def _mp4(frames: npt.NDArray[np.uint8], dt_s: float) -> bytes:
    import av

    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream: Any = container.add_stream(_CODEC, rate=Fraction(1 / dt_s).limit_denominator(1000))
        _, stream.height, stream.width, _ = frames.shape
        stream.pix_fmt = "yuv420p"  # which browsers show
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    return file.getvalue()


def _enlarged(frames: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Returns frames in colour, enlarged by a whole factor, with even sides, which the codec needs."""
    factor = max(1, _HEIGHT // frames.shape[1])
    large = np.broadcast_to(frames, (*frames.shape[:3], 3)).repeat(factor, axis=1).repeat(factor, axis=2)
    _, height, width, _ = large.shape
    return np.pad(large, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
