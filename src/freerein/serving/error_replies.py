"""`ServiceError` as a reply: an RFC 9457 problem document over HTTP, a status with google.rpc details over gRPC."""

import asyncio
import math
import re

import grpc
import orjson
from google.protobuf import any_pb2, duration_pb2
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status
from starlette.responses import Response

from freerein.errors import Internal, ModelFault, ServiceError
from freerein.serving.rest.wording import with_paths

PROBLEM_MEDIA_TYPE = "application/problem+json"
GRPC_DOMAIN = "freerein"
_MAX_TEXT_BYTES = 800  # per field: documents stay below 4 KiB, gRPC metadata below the 8 KiB that clients accept
_MAX_REASON_BYTES = 123  # of a close frame
_NO_RETRY = ("grpc-retry-pushback-ms", "-1")
TITLES = {
    400: "Malformed request",
    401: "Unauthenticated",
    403: "Permission denied",
    404: "Not found",
    405: "Method not allowed",
    408: "Request timeout",
    409: "Conflict",
    413: "Too large",
    415: "Unsupported media type",
    422: "Invalid input",
    429: "Too many requests",
    499: "Cancelled",
    500: "Internal error",
    501: "Not implemented",
    503: "Unavailable",
    504: "Deadline exceeded",
    507: "Insufficient storage",
}


def internal_error() -> Internal:
    """Returns the error that a caller sees in place of an unexpected exception."""
    return Internal("The service failed internally; its log holds the cause.", hint="Report it with the request id.")


class MethodNotAllowed(ServiceError):
    """The path has another HTTP method; `allow` names those that it has."""

    code, http_status, grpc_status = "method_not_allowed", 405, "UNIMPLEMENTED"

    allow = ""


def problem_response(error: ServiceError, request_id: str) -> Response:
    """Returns an error as a JSON problem document of at most 4 KiB; RPCs that it names have become paths."""
    document = orjson.dumps(
        {
            "type": "about:blank",
            "title": TITLES[error.http_status],
            "status": error.http_status,
            "code": error.code,
            "detail": _sanitised(with_paths(error.detail)),
            "field": _sanitised(error.field),
            "hint": _sanitised(with_paths(error.hint)),
            "request_id": request_id,
        }
    )
    headers = {"x-request-id": request_id}
    if error.retry_after_s is not None:
        headers["retry-after"] = str(max(1, math.ceil(error.retry_after_s)))
    if error.http_status == 401:
        headers["www-authenticate"] = "Bearer"
    if error.http_status in (400, 408, 413):
        headers["connection"] = "close"  # the end of this request's body is unknown, or still to come
    if isinstance(error, MethodNotAllowed):
        headers["allow"] = error.allow
    return Response(document, error.http_status, headers, PROBLEM_MEDIA_TYPE)


def error_line(error: ServiceError, request_id: str) -> str:
    """Returns an error as a text of at most 4 KiB; RPCs that it names have become paths."""
    text = with_paths(f"{error.code}: {error.detail} {error.hint}".strip())
    return f"{_sanitised(text)} (request {request_id})"


def close_reason(error: ServiceError) -> str:
    """Returns an error for the close frame of a WebSocket: its code, then the hint and the detail, in whole sentences.

    The first sentence is cut after a word where it is too long alone.
    """
    text = _sanitised(with_paths(f"{error.hint} {error.detail}".strip()))
    reason, *sentences = re.split(r"(?<=[.!?]) +", f"{error.code}: {text}")
    while sentences and len(f"{reason} {sentences[0]}".encode()) <= _MAX_REASON_BYTES:
        reason = f"{reason} {sentences.pop(0)}"
    while len(reason.encode()) > _MAX_REASON_BYTES:
        reason = reason.rpartition(" ")[0]
    return reason


async def abort_grpc(context: "grpc.aio.ServicerContext[object, object]", error: ServiceError, request_id: str) -> None:
    """Ends a gRPC call with an error: ErrorInfo always, RetryInfo when a retry can help. Never returns.

    Clients do not try again what the model failed on: the same request would count as several failures.
    """
    code, detail = grpc.StatusCode[error.grpc_status], _sanitised(error.detail)
    status = status_pb2.Status(code=code.value[0], message=detail, details=_grpc_details(error, request_id))
    error.__traceback__ = None  # gRPC keeps the error with the call, in a cycle: not the frames and their images, too
    metadata = (*rpc_status.to_status(status).trailing_metadata, *[_NO_RETRY] * isinstance(error, ModelFault))
    try:
        await context.abort(code, detail, metadata)
    except grpc.aio.InternalError:  # the client is gone, or its deadline ended just now
        raise asyncio.CancelledError from None


def _grpc_details(error: ServiceError, request_id: str) -> list[any_pb2.Any]:
    info = error_details_pb2.ErrorInfo(
        reason=error.code,
        domain=GRPC_DOMAIN,
        metadata={"field": _sanitised(error.field), "hint": _sanitised(error.hint), "request_id": request_id},
    )
    details = [any_pb2.Any()]
    details[0].Pack(info)
    if error.retry_after_s is not None:
        delay = duration_pb2.Duration()
        delay.FromNanoseconds(int(error.retry_after_s * 1e9))
        details.append(any_pb2.Any())
        details[1].Pack(error_details_pb2.RetryInfo(retry_delay=delay))
    return details


def _sanitised(text: str) -> str:
    """Returns printable text of at most 800 bytes: field names may come from the client."""
    printable = "".join(each if each.isprintable() else "?" for each in text[:_MAX_TEXT_BYTES])
    return printable.encode()[:_MAX_TEXT_BYTES].decode(errors="ignore")
