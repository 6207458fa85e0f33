"""Encoding of arrays as `{datatype, shape, raw}`, with sizes checked before anything is allocated.

`datatype` is an Open Inference Protocol name, `raw` the elements in C order, little-endian. Nothing is broadcast and no
length is inferred.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput, quoted

DTYPES: dict[str, np.dtype[Any]] = {
    "BOOL": np.dtype(np.bool_),
    "UINT8": np.dtype(np.uint8),
    "UINT16": np.dtype("<u2"),
    "UINT32": np.dtype("<u4"),
    "INT32": np.dtype("<i4"),
    "INT64": np.dtype("<i8"),
    "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
}
_NAMES = {dtype: name for name, dtype in DTYPES.items()}

MAX_AXES = 8
MAX_ELEMENTS = 2**31 - 1


def datatype(array: npt.NDArray[Any]) -> str:
    """Returns the datatype name of an array's dtype; raises InvalidInput when it is not supported."""
    try:
        return _NAMES[array.dtype.newbyteorder("<")]
    except KeyError:
        raise InvalidInput(
            f"A tensor's dtype must be one of {', '.join(DTYPES)}; got {array.dtype}.",
            hint="Convert it with array.astype(...) first.",
        ) from None


def encode(array: npt.NDArray[Any]) -> tuple[str, tuple[int, ...], bytes]:
    """Returns the (datatype, shape, raw) of an array of any shape; raises as `datatype`."""
    name = datatype(array)
    return name, array.shape, array.astype(DTYPES[name], copy=False).tobytes()


def encode_in_place(array: npt.NDArray[Any]) -> tuple[str, tuple[int, ...], npt.NDArray[np.uint8]]:
    """Returns what `encode` does, `raw` as a view of the array where it is contiguous."""
    name = datatype(array)
    return name, array.shape, np.ascontiguousarray(array, DTYPES[name]).reshape(-1).view(np.uint8)


def decode(name: str, shape: Sequence[int], raw: bytes, *, field: str = "") -> npt.NDArray[Any]:
    """Returns the array of (datatype, shape, raw), a read-only view of `raw`; `field` is its dotted name, for errors.

    Raises:
        InvalidInput: The datatype is unknown, the shape has a negative length, too many axes or elements, `raw` has the
            wrong length, or a BOOL is neither 0 nor 1.
    """
    dtype = DTYPES.get(name)
    if dtype is None:
        raise InvalidInput(
            f"`{field}` must have one of the datatypes {', '.join(DTYPES)}; got {quoted(name)}.",
            field=field,
            hint="Name the datatype as the Open Inference Protocol does, such as FP32.",
        )
    if len(shape) > MAX_AXES or min(shape, default=0) < 0 or math.prod(n or 1 for n in shape) > MAX_ELEMENTS:
        raise InvalidInput(
            f"`{field}` must have a shape of at most {MAX_AXES} lengths, none negative, of at most {MAX_ELEMENTS} "
            f"elements; got {len(shape)} lengths that violate this.",
            field=field,
            hint="Wildcards are not supported: give the length of every axis.",
        )
    expected = math.prod(shape) * dtype.itemsize  # Python integers: no overflow
    if len(raw) != expected:
        raise InvalidInput(
            f"`{field}` must hold {expected} bytes for its shape and datatype; got {len(raw)}.",
            field=field,
            hint="Send the elements in C order, little-endian, without padding.",
        )
    if dtype == np.bool_ and raw and max(raw) > 1:
        raise InvalidInput(
            f"`{field}` must hold only bytes 0 and 1 for BOOL; got another value.",
            field=field,
            hint="Send array.astype(bool).tobytes().",
        )
    return np.frombuffer(raw, dtype).reshape(shape)
