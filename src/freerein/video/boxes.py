"""The boxes that an mp4 file consists of, checked before a decoder sees the file."""

import os

from freerein.errors import InvalidInput, UnsupportedMedia

_MAX_BOXES = 100_000
_HEADER, _LONG_HEADER = 8, 16
_LONG_SIZE = 1  # announces a size of 64 bits
_OPEN_SIZE = 0  # of a last box, whose recorder did not know it
_FIRST = frozenset((b"ftyp", b"wide", b"mdat", b"moov", b"free", b"skip", b"pnot", b"uuid"))
"""Kinds of a first box; QuickTime needs no `ftyp`."""


def check_boxes(file: int, *, field: str) -> None:
    """Checks that a file is a complete sequence of the boxes of mp4 and QuickTime.

    A file that was cut off anywhere ends inside a box, or lacks `moov`, its index.

    Args:
        file: Descriptor of the file.
        field: Name of the file in the request, for errors.

    Raises:
        UnsupportedMedia: It is neither mp4 nor QuickTime.
        InvalidInput: It is truncated.
    """
    size = os.fstat(file).st_size
    if os.pread(file, _HEADER, 0)[4:] not in _FIRST:
        raise UnsupportedMedia(
            f"`{field}` must be an mp4 or mov file; got {size} bytes of another format.",
            field=field,
            hint="Convert it: ffmpeg -i IN -c:v libx264 OUT.mp4.",
        )
    position, has_index = 0, False
    for _ in range(_MAX_BOXES):
        header = os.pread(file, _LONG_HEADER, position)
        length = int.from_bytes(header[:4])
        if length == _LONG_SIZE:
            length = int.from_bytes(header[8:])
        elif length == _OPEN_SIZE:
            length = size - position
        has_index |= header[4:8] == b"moov"
        position += length
        if length < _HEADER or position > size:
            break
        if position == size and has_index:
            return
    raise InvalidInput(
        f"`{field}` must be a complete mp4 file; it is corrupt or truncated.",
        field=field,
        hint="Copy it again, or let its recorder finish it.",
    )
