"""Frames of a reply as one PNG."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from google.protobuf.descriptor import Descriptor

from freerein import images

MEDIA_TYPE = "image/png"


def holds_frames(message: Descriptor) -> bool:
    """Returns whether a message is frames by camera alone."""
    return [field.name for field in message.fields] == ["frames"]


def wants_png(accept: str) -> bool:
    """Returns whether a header `Accept` names PNG, and JSON not before it."""
    named = [each.split(";")[0].strip().lower() for each in accept.split(",")]
    return MEDIA_TYPE in named and "application/json" not in named[: named.index(MEDIA_TYPE)]


def png_of(frames: Mapping[str, npt.NDArray[np.uint8]]) -> bytes:
    """Returns a PNG of frames uint8 (N, H, W, 1 or 3) by camera: a column for each camera, a row for each of N.

    Columns that are less high end in black.
    """
    columns = [np.concatenate(list(each), axis=0) for each in frames.values()]  # (N * H, W, C) each
    height = max(len(column) for column in columns)
    sheet: Any = np.zeros((height, sum(column.shape[1] for column in columns), 3), np.uint8)
    left = 0
    for column in columns:
        sheet[: len(column), left : left + column.shape[1]] = column
        left += column.shape[1]
    return images.encode(sheet).data
