"""`ServiceError`s as RFC 9457 problem documents, never above 4 KiB."""

import math
from typing import Any

import orjson

from freerein.errors import ServiceError

MEDIA_TYPE = "application/problem+json"
_LONGEST_TEXT = 800
_TITLES = {
    400: "Malformed request",
    401: "Unauthenticated",
    404: "Not found",
    405: "Method not allowed",
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
}


def document(error: ServiceError, request_id: str) -> bytes:
    """Returns the JSON document of an error."""
    problem: dict[str, Any] = {
        "type": "about:blank",
        "title": _TITLES[error.http_status],
        "status": error.http_status,
        "code": error.code,
        "detail": shortened(error.detail),
        "field": shortened(error.field),
        "hint": shortened(error.hint),
        "request_id": request_id,
    }
    return orjson.dumps(problem)


def shortened(text: str) -> str:
    """Returns a text as an error may carry it, in at most 800 bytes: a field may be named by whoever sent it."""
    printable = "".join(each if each.isprintable() else "?" for each in text[:_LONGEST_TEXT])
    return printable.encode()[:_LONGEST_TEXT].decode(errors="ignore")


def headers(error: ServiceError, request_id: str) -> dict[str, str]:
    """Returns the headers that belong to an error's document."""
    result = {"content-type": MEDIA_TYPE, "x-request-id": request_id}
    if error.retry_after_s is not None:
        result["retry-after"] = str(max(1, math.ceil(error.retry_after_s)))
    if error.http_status == 401:
        result["www-authenticate"] = "Bearer"
    if error.http_status in (400, 413):
        result["connection"] = "close"  # where this request ends is not known, or is not waited for
    return result
