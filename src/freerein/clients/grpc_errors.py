"""gRPC's errors as ours: the inverse of what services do with `freerein.errors` at their gRPC door.

A service's error is a status whose details (`google.rpc.Status` in the trailing metadata) hold an `ErrorInfo` with the
error's code, and a `RetryInfo` when another try may help. A status without them was made by gRPC itself, here or
there: nobody listens, the deadline passed, a message was over the limit.
"""

from typing import TypeVar

import grpc
from google.protobuf.message import DecodeError, Message
from google.rpc import error_details_pb2, status_pb2
from grpc import aio

from freerein import errors
from freerein.errors import ServiceError

DOMAIN = "freerein"

M = TypeVar("M", bound=Message)

_DETAILS_KEY = "grpc-status-details-bin"
_TOO_LARGE = "larger than max"  # gRPC's words for a message over the limit; the status is that of a full queue
_BROKEN = "Internal error from Core"  # grpc.aio's words for a stream that ended while it was being written to
_BY_STATUS: dict[grpc.StatusCode, type[ServiceError]] = {
    grpc.StatusCode.CANCELLED: errors.Cancelled,
    grpc.StatusCode.DEADLINE_EXCEEDED: errors.DeadlineExceeded,
    grpc.StatusCode.INVALID_ARGUMENT: errors.InvalidInput,
    grpc.StatusCode.NOT_FOUND: errors.NotFound,
    grpc.StatusCode.RESOURCE_EXHAUSTED: errors.Overloaded,
    grpc.StatusCode.UNAUTHENTICATED: errors.Unauthenticated,
    grpc.StatusCode.UNAVAILABLE: errors.Unavailable,
    grpc.StatusCode.UNIMPLEMENTED: errors.Unimplemented,
}
_HINTS: dict[type[ServiceError], str] = {
    errors.DeadlineExceeded: "Allow more time with `timeout_s`, or ask for less.",
    errors.TooLarge: "Send or ask for less at a time.",
    errors.Unavailable: "Check that the service runs and that this is its gRPC address.",
    errors.Unimplemented: "Check that this address is the service's, and that it has the client's version.",
}


def service_error(error: aio.AioRpcError, *, call: str) -> ServiceError:
    """Returns the error that a failed call stands for.

    Args:
        error: What gRPC raised.
        call: What was called and where, for the errors that gRPC itself makes, such as `Step at 127.0.0.1:9104`.
    """
    status = _status(error)
    info = _detail(status, error_details_pb2.ErrorInfo)
    if info is None or info.domain != DOMAIN:
        return _grpc_made(error, call=call)
    retry = _detail(status, error_details_pb2.RetryInfo)
    return errors.by_code(info.reason)(
        status.message,
        field=info.metadata.get("field", ""),
        hint=info.metadata.get("hint", ""),
        retry_after_s=retry.retry_delay.ToTimedelta().total_seconds() if retry else None,
    )


def _status(error: aio.AioRpcError) -> status_pb2.Status:
    """Returns the status in the metadata; an empty one where there is none that can be read."""
    value = dict(error.trailing_metadata() or ()).get(_DETAILS_KEY, b"")
    try:
        return status_pb2.Status.FromString(value)
    except DecodeError:
        return status_pb2.Status()


def _detail(status: status_pb2.Status, kind: type[M]) -> M | None:
    detail = kind()
    try:
        return detail if any(packed.Unpack(detail) for packed in status.details) else None
    except DecodeError:
        return None


def _grpc_made(error: aio.AioRpcError, *, call: str) -> ServiceError:
    details = error.details() or error.code().name
    cls = _BY_STATUS.get(error.code(), errors.Internal)
    if _TOO_LARGE in details:
        cls = errors.TooLarge
    elif _BROKEN in details:
        cls = errors.Unavailable
    return cls(f"{call} failed: {details}.", hint=_HINTS.get(cls, ""))
