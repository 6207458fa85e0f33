"""Labels of many trajectories in one line of a result, so that later figures need no training."""

import base64
import zlib
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Labels = npt.NDArray[np.int64]

PACKED, PACKED_DECODED = "packed_labels", "packed_decoded_labels"
"""Names, after the split's, of what results show: labels as they are, and decoded."""


def pack(labels: Sequence[Labels]) -> str:
    """Returns labels, int64 (T,) per trajectory and below 256, as base64 of their compressed bytes."""
    joined = np.concatenate(labels)
    if joined.min() < 0 or joined.max() > np.iinfo(np.uint8).max:
        raise ValueError("Labels that are packed must be in [0, 255].")
    return base64.b64encode(zlib.compress(joined.astype(np.uint8).tobytes(), 9)).decode()


def unpack(packed: str, lengths: Sequence[int]) -> list[Labels]:
    """Returns what was packed, int64 (T,) per trajectory, given each T."""
    joined = np.frombuffer(zlib.decompress(base64.b64decode(packed)), np.uint8).astype(np.int64)
    return np.split(joined, np.cumsum(lengths)[:-1])
