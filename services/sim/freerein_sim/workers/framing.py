"""How the service and its workers talk over a socket pair: framed messages of the public contract.

    length of the message (4) | which call (1) | number of the call (8) | the message, protobuf

Little-endian. A reply bears the call and number of its request; a refusal the call `REFUSED` and an `Error`.
"""

import struct
from dataclasses import dataclass
from typing import Any, cast

from freerein import wire
from freerein.errors import ServiceError, TooLarge, by_code
from freerein.types import sim
from freerein.types.common import Error

MAX_MESSAGE_BYTES = 65 * 2**20
"""What a door lets through, and a little for what is around it."""

REFUSED = 0
CALLS: tuple[tuple[type[Any], type[Any]], ...] = (
    (Error, Error),  # REFUSED; nobody asks for it
    (sim.ListTasksRequest, sim.ListTasksResponse),
    (sim.CreateSessionRequest, sim.CreateSessionResponse),
    (sim.ResetRequest, sim.ResetResponse),
    (sim.StepRequest, sim.StepResponse),
    (sim.RenderRequest, sim.RenderResponse),
    (sim.SnapshotRequest, sim.SnapshotResponse),
    (sim.RestoreRequest, sim.RestoreResponse),
    (sim.DemonstrateRequest, sim.DemonstrateResponse),  # one trajectory: the one at `first`
    (sim.CloseSessionRequest, sim.CloseSessionResponse),
)
"""What can be asked, and what answers it."""

_NUMBERS = {request: number for number, (request, _) in enumerate(CALLS)}
_HEADER = struct.Struct("<IBQ")
HEADER_BYTES = _HEADER.size


@dataclass(frozen=True)
class Header:
    """What precedes a message.

    Attributes:
        length: The message's bytes.
        call: Index into `CALLS`.
        number: Of the call, counted by who asks.
    """

    length: int
    call: int
    number: int


def call_of(request: object) -> int:
    """Returns the index into `CALLS` of a request."""
    return _NUMBERS[type(request)]


def encode(message: object, *, call: int, number: int) -> tuple[bytes, bytes]:
    """Returns a dataclass as (header, message).

    Raises:
        TooLarge: It is longer than `MAX_MESSAGE_BYTES`.
    """
    body = wire.pack(message).SerializeToString()
    _check_length(len(body))
    return _HEADER.pack(len(body), call, number), body


def decode_header(data: bytes | bytearray) -> Header:
    """Returns the header that `HEADER_BYTES` bytes describe.

    Raises:
        TooLarge: It announces more than `MAX_MESSAGE_BYTES`: nothing is allocated for it.
    """
    header = Header(*_HEADER.unpack(data))
    _check_length(header.length)
    return header


def decode(data: bytes | bytearray, cls: type[wire.T]) -> wire.T:
    """Returns the dataclass that bytes describe."""
    message = wire.message_type(cls)()
    message.MergeFromString(cast(bytes, data))  # it reads any buffer; its stub knows bytes only
    return wire.unpack(message, cls)


def error_message(error: ServiceError) -> Error:
    """Returns an error as it crosses the socket."""
    return Error(error.code, error.detail, error.field, error.hint, error.retry_after_s or 0.0)


def error_from(message: Error) -> ServiceError:
    """Returns the error that crossed the socket."""
    return by_code(message.code)(
        message.detail, field=message.field, hint=message.hint, retry_after_s=message.retry_after_s or None
    )


def _check_length(length: int) -> None:
    if length > MAX_MESSAGE_BYTES:
        raise TooLarge(
            f"A message to or from a worker must be at most {MAX_MESSAGE_BYTES} bytes; got {length}.",
            hint="Ask for fewer environments, cameras or pixels at once.",
        )
