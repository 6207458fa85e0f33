"""The protocol between the service and its worker processes: framed messages of the public API over a socket pair.

    message length (4) | call (1) | request number (8) | message, protobuf

Little-endian. A reply carries the call and number of its request; an error the call `REFUSED` and an `Error`.
"""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from freerein import wire
from freerein.errors import InvalidInput, TooLarge, must_be
from freerein.types import sim
from freerein.types.common import Error

MAX_MESSAGE_BYTES = 65 * 2**20
"""The service's message limit of 64 MiB, and 1 MiB of overhead."""

MAX_ENVS = 64
"""Environments of one session."""

MAX_SIZE_PX = 320
MAX_FRAME_BYTES = 63 * 2**20
"""Frames in one reply."""

REFUSED = 0
CALLS: tuple[type[Any], ...] = (
    Error,  # REFUSED; never a request
    sim.ListTasksRequest,
    sim.CreateSessionRequest,
    sim.ResetRequest,
    sim.StepRequest,
    sim.RenderRequest,
    sim.SnapshotRequest,
    sim.RestoreRequest,
    sim.DemonstrateRequest,  # one trajectory: the one at `first`
    sim.CheckRequest,
    sim.ExpertActionsRequest,
    sim.CloseSessionRequest,
    sim.DrawRecipesRequest,
)
"""Request of each call."""

_HEADER = struct.Struct("<IBQ")
HEADER_BYTES = _HEADER.size


class Header(NamedTuple):
    """Header of a frame: bytes of the message, index into `CALLS`, and number of the request."""

    length: int
    call: int
    number: int


def encode(message: object, *, call: int, number: int) -> tuple[bytes, bytes]:
    """Returns a dataclass as (header, message). Raises TooLarge above `MAX_MESSAGE_BYTES`."""
    body = wire.pack(message).SerializeToString()
    _check_length(len(body))
    return _HEADER.pack(len(body), call, number), body


def decode_header(data: bytes | bytearray) -> Header:
    """Returns the header of `HEADER_BYTES` bytes. Raises TooLarge if it announces more than `MAX_MESSAGE_BYTES`."""
    header = Header(*_HEADER.unpack(data))
    _check_length(header.length)
    return header


def decode(data: bytes | bytearray, cls: type[wire.T]) -> wire.T:
    """Returns the dataclass of a message."""
    message = wire.message_type(cls)()
    message.MergeFromString(cast(bytes, data))  # it reads any buffer; its stub knows bytes only
    return wire.unpack(message, cls)


def check_frames(task: sim.Task, cameras: Sequence[str], *, height: int, width: int, images: int) -> None:
    """Checks the size of a reply before anything is rendered. Ignores unknown cameras: the worker refuses them.

    A height or width of 0 means the cameras' own; `images` is the greatest number of images per camera in the reply.
    """
    if not (0 <= height <= MAX_SIZE_PX and 0 <= width <= MAX_SIZE_PX):
        rule, got = f"at most {MAX_SIZE_PX} pixels", f"{height} and {width}"
        raise must_be("`height` and `width`", rule, got, field="height")
    frame_bytes = sum(
        images * (height or camera.height) * (width or camera.width) * camera.channels
        for camera in task.cameras
        if camera.name in cameras
    )
    if frame_bytes > MAX_FRAME_BYTES:
        raise InvalidInput(
            f"The frames of one reply must have at most {MAX_FRAME_BYTES} bytes; these may have {frame_bytes}.",
            field="cameras",
            hint="Ask for fewer or smaller cameras, or hold fewer environments.",
        )


def _check_length(length: int) -> None:
    if length > MAX_MESSAGE_BYTES:
        raise TooLarge(
            f"A message to or from a worker must be at most {MAX_MESSAGE_BYTES} bytes; got {length}.",
            hint="Ask for fewer environments, cameras or pixels at once.",
        )
