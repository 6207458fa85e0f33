"""The protocol between the two processes of a video: the options, and the records of the pipe.

A record is a kind, a length of 32 bits and as many bytes:

    I   once: JSON with the fields of a `VideoInfo`
    F   for each frame: its time in seconds (float64), then its pixels
    E   once, at the end of the video
    X   instead of any further record: why the file cannot be decoded; `freerein.video.refusals` knows the reasons
"""

import json
import struct
from dataclasses import asdict, dataclass

RECORD = struct.Struct("<cI")
TIME = struct.Struct("<d")
CODECS = ("h264", "hevc", "av1", "vp9", "mpeg4", "mjpeg")


@dataclass(frozen=True)
class Options:
    """The part of a video to decode, and its bounds.

    Frames have 3 channels for RGB, 1 for gray, and a height and width of 0 to keep the file's. `max_pixels` are those
    of a frame of the file; `memory_bytes` and `cpu_s` those of the child process. Frames before `start_s`, in seconds,
    are left out, but for the last where all are.
    """

    channels: int
    height: int
    width: int
    max_frames: int
    max_pixels: int
    memory_bytes: int
    cpu_s: int
    start_s: float = 0.0

    def to_json(self) -> str:
        """Returns the options as JSON."""
        return json.dumps(asdict(self))
