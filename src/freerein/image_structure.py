"""The structure of an image file, checked before a decoder runs: what may not be there, and how much of it may.

Decoders spend time on every chunk, segment and scan. A scan of 30 bytes passes over all pixels of a JPEG.
"""

import struct
from collections.abc import Callable

from freerein.errors import InvalidInput
from freerein.types.common import Encoding

MAX_PNG_CHUNKS = 16_384  # libpng writes 8 KiB each: 8 192 in the largest message
MAX_JPEG_SEGMENTS = 256  # before the first scan; cameras write up to about 30
MAX_JPEG_SCANS = 32  # libjpeg's progressive files have 10 scans, 18 in CMYK
MAX_WEBP_CHUNKS = 256

_START_OF_SCAN = b"\xff\xda"
# Frames, tables, applications' data and comments. The other markers have no length, and decoders search for the next.
_JPEG_SEGMENTS = frozenset({*range(0xC0, 0xD0), *range(0xDB, 0xF0), 0xFE} - {0xC8})


def check_structure(data: bytes, encoding: Encoding, *, field: str) -> None:
    """Checks the parts of a PNG, JPEG or WebP file that begins with its signature.

    Raises:
        InvalidInput: The file has too many chunks, segments or scans.
        ValueError: The file is corrupt.
    """
    unit, most, count = _PARTS[encoding]
    _check_count(count(data, most), most, unit, field)
    if encoding == "jpeg":  # these bytes are nothing else in a scan, and rarely in a segment
        _check_count(data.count(_START_OF_SCAN), MAX_JPEG_SCANS, "scans", field)


def _check_count(count: int, most: int, unit: str, field: str) -> None:
    if count > most:
        raise InvalidInput(
            f"`{field}` may have at most {most} {unit} each; one has more.",
            field=field,
            hint="Open and save the image again, without metadata.",
        )


def _count_png_chunks(data: bytes, most: int) -> int:
    """Returns the number of chunks, at most one above `most`; IHDR must be the first, and no other."""
    at, count = 8, 0
    while at + 8 <= len(data) and count <= most:
        length, kind = struct.unpack_from(">I4s", data, at)
        if (kind == b"IHDR") != (count == 0):
            raise ValueError("IHDR is not the first chunk")
        at += 12 + length
        count += 1
    return count


def _count_jpeg_segments(data: bytes, most: int) -> int:
    """Returns the number of segments before the first scan, at most one above `most`."""
    at, count = 2, 0
    while count <= most:
        mark, marker, length = struct.unpack_from(">BBH", data, at)
        if data.startswith(_START_OF_SCAN, at):
            break
        if mark != 0xFF or marker not in _JPEG_SEGMENTS or length < 2:
            raise ValueError("bytes between segments")
        at += 2 + length
        count += 1
    return count


def _count_webp_chunks(data: bytes, most: int) -> int:
    """Returns the number of chunks, at most one above `most`."""
    at, count = 12, 0
    while at + 8 <= len(data) and count <= most:
        (length,) = struct.unpack_from("<I", data, at + 4)
        at += 8 + length + length % 2
        count += 1
    return count


_PARTS: dict[Encoding, tuple[str, int, Callable[[bytes, int], int]]] = {
    "png": ("chunks", MAX_PNG_CHUNKS, _count_png_chunks),
    "jpeg": ("segments", MAX_JPEG_SEGMENTS, _count_jpeg_segments),
    "webp": ("chunks", MAX_WEBP_CHUNKS, _count_webp_chunks),
}
