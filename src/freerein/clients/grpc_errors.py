"""Translates gRPC errors to `freerein.errors`, the inverse of `freerein.serving`.

A service's error is a `google.rpc.Status` in the trailing metadata with an `ErrorInfo`, and a `RetryInfo` when a retry
may help. A status without them was raised by gRPC itself: no connection, deadline exceeded, message too large.
"""

from typing import TypeVar

import grpc
from google.protobuf.message import DecodeError, Message
from google.rpc import error_details_pb2, status_pb2
from grpc import aio

from freerein import errors
from freerein.clients.stream_responses import WRITE_FAILED
from freerein.errors import ServiceError

DOMAIN = "freerein"

M = TypeVar("M", bound=Message)

_DETAILS_KEY = "grpc-status-details-bin"
_TOO_LARGE = "larger than max"  # gRPC's message for one over the limit; its status is that of a full queue
_TLS_HINTS = {
    "wrong_version_number": "The service does not speak TLS: leave out the certificate, or start it with one.",
    # in `certificate verify failed` and `Hostname Verification Check failed`
    "verif": "Its certificate must be trusted and name the host in this address; `freerein doctor` says what is wrong.",
}
_BY_STATUS: dict[grpc.StatusCode, type[ServiceError]] = {
    grpc.StatusCode.CANCELLED: errors.Unavailable,  # gRPC's own, of a call that a server that stops has not begun
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
    errors.Unimplemented: "Check that this is the service's gRPC address, not REST's, and of the client's version.",
}


def service_error(error: aio.AioRpcError, *, call: str, proxy: str = "") -> ServiceError:
    """Returns the `ServiceError` of a failed call, which took the proxy of the environment variable `proxy`, if any."""
    status = _status(error)
    info = _detail(status, error_details_pb2.ErrorInfo)
    if info is None or info.domain != DOMAIN:
        return _grpc_own_error(error, call=call, proxy=proxy)
    retry = _detail(status, error_details_pb2.RetryInfo)
    return errors.by_code(info.reason)(
        status.message,
        field=info.metadata.get("field", ""),
        hint=info.metadata.get("hint", ""),
        retry_after_s=retry.retry_delay.ToTimedelta().total_seconds() if retry else None,
    )


def _status(error: aio.AioRpcError) -> status_pb2.Status:
    """Returns the status in the metadata, empty where it is missing or unreadable."""
    pairs = iter(error.trailing_metadata() or ())  # which in an older grpcio is a mapping whose `keys` are pairs, too
    value = dict(pairs).get(_DETAILS_KEY, b"")
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


def _grpc_own_error(error: aio.AioRpcError, *, call: str, proxy: str) -> ServiceError:
    details = error.details() or error.code().name
    cls = _BY_STATUS.get(error.code(), errors.Internal)
    if _TOO_LARGE in details:
        cls = errors.TooLarge
    elif WRITE_FAILED in details:
        cls = errors.Unavailable
    hint = next((hint for part, hint in _TLS_HINTS.items() if part in details.lower()), _HINTS.get(cls, ""))
    if proxy and cls in (errors.Unavailable, errors.DeadlineExceeded):
        hint += f" It was called by the proxy in `{proxy}`: write its host into `no_proxy` to call it directly."
    return cls(f"{call} failed: {details}.", hint=hint)
