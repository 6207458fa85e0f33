"""WAD files: a header of 12 bytes, lumps of bytes, and a directory of 16 bytes a lump. Little-endian.

Format: https://doomwiki.org/wiki/WAD.
"""

import struct
from collections.abc import Sequence

_HEADER = struct.Struct("<4sii")  # kind, number of lumps, where the directory begins
_ENTRY = struct.Struct("<ii8s")  # where the lump begins, its length, its name

Lumps = Sequence[tuple[str, bytes]]
"""Lumps by name, in order; names may occur more than once."""


def read(data: bytes) -> list[tuple[str, bytes]]:
    """Returns the lumps of a WAD file."""
    _, count, directory = _HEADER.unpack_from(data)
    entries = _ENTRY.iter_unpack(data[directory : directory + count * _ENTRY.size])
    return [(name.split(b"\0")[0].decode("ascii"), data[begin : begin + length]) for begin, length, name in entries]


def write(lumps: Lumps) -> bytes:
    """Returns a WAD file that patches the game's own, a PWAD."""
    content, entries = b"", b""
    for name, lump in lumps:
        entries += _ENTRY.pack(_HEADER.size + len(content), len(lump), name.encode("ascii"))
        content += lump
    return _HEADER.pack(b"PWAD", len(lumps), _HEADER.size + len(content)) + content + entries
