"""The structure of an image file, checked before a decoder runs: what may not be there, and how much of it may.

Decoders spend time on every chunk, segment and scan. A scan of 30 bytes passes over all pixels of a JPEG. A colour
profile of 1 KiB unpacks to 1 MiB.
"""

import re
import struct

from freerein.errors import must_be
from freerein.types.common import Encoding

MAX_SMALL_PARTS = 64  # chunks or segments; more must have a KiB each on average
MAX_PARTS = 256  # of a JPEG or WebP; the pixels of a PNG come in many chunks
MAX_JPEG_SCANS = 32  # libjpeg's progressive files have 10 scans, 18 in CMYK
_MAX_FILL = 1024  # bytes

_START_OF_SCAN = 0xDA
_END_OF_IMAGE = b"\xff\xd9"
# Frames, tables, scans, applications' data and comments. Decoders disagree on the length of others, or know none.
_JPEG_SEGMENTS = frozenset({*range(0xC0, 0xD0), *range(0xDA, 0xF0), 0xFE} - {0xC8})
_MARKER_AFTER_SCAN = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")  # neither a byte of the scan nor a restart
_PNG_CHUNKS = frozenset({b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND", b"acTL", b"fcTL", b"fdAT"})  # last: animations


def checked_structure(data: bytes, encoding: Encoding, *, field: str) -> bytes:
    """Returns the parts that a decoder needs of a PNG, JPEG or WebP file that begins with its signature.

    Raises:
        InvalidInput: The file has too many chunks, segments or scans.
        ValueError: The file is corrupt.
    """
    most = MAX_SMALL_PARTS + len(data) // 1024
    if encoding == "png":
        return _without_metadata(data, most, field)
    most = min(most, MAX_PARTS)
    if encoding == "webp":
        _check_count(_count_webp_chunks(data, most), most, "chunks", field)
    else:
        segments, scans = _count_jpeg_segments(data, most)
        _check_count(segments, most, "segments", field)
        _check_count(scans, MAX_JPEG_SCANS, "scans", field)
    return data


def _check_count(count: int, most: int, unit: str, field: str) -> None:
    if count > most:
        rule = f"of at most {most} {unit} in a file of its size"
        raise must_be(field, rule, "more", hint="Open and save the image again, without metadata.")


def _without_metadata(data: bytes, most: int, field: str) -> bytes:
    """Returns a PNG of at most so many chunks without those that may unpack; IHDR must be the first, and no other."""
    at, count, kept = 8, 0, [data[:8]]
    while at + 8 <= len(data) and count <= most:
        length, kind = struct.unpack_from(">I4s", data, at)
        if (kind == b"IHDR") != (count == 0):
            raise ValueError("IHDR is not the first chunk")
        if kind in _PNG_CHUNKS:
            kept.append(data[at : at + 12 + length])
        at += 12 + length
        count += 1
    _check_count(count, most, "chunks", field)
    return b"".join(kept)


def _count_jpeg_segments(data: bytes, most: int) -> tuple[int, int]:
    """Returns the number of segments and that of scans, each at most one above its limit."""
    at, segments, scans, fill = 2, 0, 0, 0
    while segments <= most and scans <= MAX_JPEG_SCANS and not data.startswith(_END_OF_IMAGE, at):
        if data.startswith(b"\xff\xff", at):  # the standard allows bytes of fill before a marker
            at, fill = at + 1, fill + 1
            if fill > _MAX_FILL:
                raise ValueError("bytes between segments")
            continue
        mark, marker, length = struct.unpack_from(">BBH", data, at)
        if mark != 0xFF or marker not in _JPEG_SEGMENTS or length < 2:
            raise ValueError("bytes between segments")
        at += 2 + length
        segments += 1
        if marker == _START_OF_SCAN:
            scans += 1
            following = _MARKER_AFTER_SCAN.search(data, at)
            if following is None:
                break
            at = following.start()
    return segments, scans


def _count_webp_chunks(data: bytes, most: int) -> int:
    """Returns the number of chunks, at most one above `most`."""
    at, count = 12, 0
    while at + 8 <= len(data) and count <= most:
        (length,) = struct.unpack_from("<I", data, at + 4)
        at += 8 + length + length % 2
        count += 1
    return count
