"""The error of each reason for which a video is not decoded."""

import re

from freerein.errors import InvalidInput, ServiceError, UnsupportedMedia
from freerein.video.records import CODECS, Options

_ENCODE_AGAIN = "Encode it again: ffmpeg -i IN -c:v libx264 OUT.mp4."
_CODEC = re.compile(r"codec ([a-z0-9_]{1,32})")
_SCALE_DOWN = "Scale it down first: ffmpeg -i IN -vf scale=320:-2 OUT.mp4."


def refusal(reason: str, options: Options, *, silence_s: float, field: str) -> ServiceError:
    """Returns the error of a reason of the decoder, of `cpu` or `silence`; of another, that of a corrupt file.

    `silence_s` is the longest wait for a frame, and `field` the video's name in the request. The reason `codec` is
    followed by the codec's name, where there is one.
    """
    if reason.startswith("codec"):
        found = _CODEC.fullmatch(reason)
        return UnsupportedMedia(
            f"`{field}` must be encoded with {', '.join(CODECS[:-1])} or {CODECS[-1]}; "
            f"it has {f'the codec {found[1]}' if found else 'another codec'}.",
            field=field,
            hint=_ENCODE_AGAIN,
        )
    must, is_, hint = {
        "cpu": (f"be decoded within {options.cpu_s} s of CPU time", "takes longer", _SCALE_DOWN),
        "frames": (f"have at most {options.max_frames} frames", "has more", "Cut it."),
        "memory": (f"be decoded in {options.memory_bytes >> 20} MiB", "needs more", _SCALE_DOWN),
        "pixels": (f"have frames of at most {options.max_pixels} pixels", "has larger ones", _SCALE_DOWN),
        "silence": (f"give each frame within {silence_s:g} s", "takes longer", f"Try again. {_SCALE_DOWN}"),
        "size": ("have frames of one size", "has several", _ENCODE_AGAIN),
        "stream": ("have a video stream", "has none", "Send the file that holds the pictures."),
    }.get(reason, ("be a complete mp4 file", "is corrupt or truncated", _ENCODE_AGAIN))
    return InvalidInput(f"`{field}` must {must}; it {is_}.", field=field, hint=hint)
