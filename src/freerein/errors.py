"""The errors of freerein's public interfaces; `docs/protocol.md` lists them with their HTTP and gRPC statuses.

`freerein.serving` maps these classes to HTTP and gRPC, `freerein.clients` maps them back. `detail` is one sentence that
says what was expected and what was received, `hint` says how to fix it. Neither holds a path, a traceback, a repr or a
copy of the input but for a number or a `quoted` text.
"""

import sys
from collections.abc import Iterator

_LONGEST = 64


class ServiceError(Exception):
    """Base of all errors that a caller can read and act on.

    Args:
        detail: One sentence: what was expected, what was received.
        field: Dotted name of the invalid request field, or empty.
        hint: How to fix it.
        retry_after_s: Seconds after which a retry may succeed; None when it cannot.
    """

    code = "internal"
    http_status = 500
    grpc_status = "INTERNAL"

    def __init__(self, detail: str, *, field: str = "", hint: str = "", retry_after_s: float | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.field = field
        self.hint = hint
        self.retry_after_s = retry_after_s

    if sys.version_info < (3, 11):  # from then on, all exceptions have it

        def add_note(self, note: str) -> None:
            """Appends a line to the message."""
            self.args = (f"{self}\n{note}",)


class MalformedRequest(ServiceError):
    """The bytes cannot be parsed as a request."""

    code, http_status, grpc_status = "malformed_request", 400, "INVALID_ARGUMENT"


class InvalidInput(ServiceError):
    """A value of the request is invalid."""

    code, http_status, grpc_status = "invalid_input", 422, "INVALID_ARGUMENT"


def must_be(name: str, rule: str, got: object, *, field: str | None = None, hint: str = "") -> InvalidInput:
    """Returns the error of a value that is not as it must be, such as: `fps` must be 1 to 1000; got 0.

    Args:
        name: Name of the field; in words where `field` is given.
        rule: What was expected.
        got: What was received: a number, words, or a `quoted` text.
        field: Dotted name of the field, or empty, where `name` is not.
        hint: How to fix it.
    """
    subject, field = (f"`{name}`", name) if field is None else (name, field)
    return InvalidInput(f"{subject} must be {rule}; got {got}.", field=field, hint=hint)


def quoted(text: str) -> str:
    """Returns a text of another program for an error: printable, and of at most 64 characters."""
    printable = "".join(each if each.isprintable() and each != "`" else "?" for each in text[: _LONGEST + 1])
    return f"`{printable if len(text) <= _LONGEST else printable[:_LONGEST] + '...'}`"


class OutputNotFinite(InvalidInput):
    """The model's output overflowed on this input."""

    code = "output_not_finite"


class UnsupportedMedia(ServiceError):
    """Unsupported content type, content encoding or image format."""

    code, http_status, grpc_status = "unsupported_media", 415, "INVALID_ARGUMENT"


class Unauthenticated(ServiceError):
    """The token is missing or wrong."""

    code, http_status, grpc_status = "unauthenticated", 401, "UNAUTHENTICATED"


class PermissionDenied(ServiceError):
    """A web page of another origin calls, or calls a service on loopback by another name."""

    code, http_status, grpc_status = "permission_denied", 403, "PERMISSION_DENIED"


class NotFound(ServiceError):
    """The session, fit, model, task, dataset or route does not exist."""

    code, http_status, grpc_status = "not_found", 404, "NOT_FOUND"


class SessionNotFound(NotFound):
    """The session was never made, was closed, or its lease has ended."""

    code = "session_not_found"


class RequestTimeout(ServiceError):
    """The request did not arrive in time."""

    code, http_status, grpc_status = "request_timeout", 408, "DEADLINE_EXCEEDED"


class AlreadyExists(ServiceError):
    """The name or idempotency key belongs to something else."""

    code, http_status, grpc_status = "already_exists", 409, "ALREADY_EXISTS"


class FailedPrecondition(ServiceError):
    """The object exists, but is not in the state that the call needs."""

    code, http_status, grpc_status = "failed_precondition", 409, "FAILED_PRECONDITION"


class StepOutOfOrder(FailedPrecondition):
    """The `step_id` does not follow the session's last step."""

    code = "step_out_of_order"


class WorkerLost(ServiceError):
    """The worker process of the session ended, and the session with it."""

    code, http_status, grpc_status = "worker_lost", 409, "ABORTED"


class TooLarge(ServiceError):
    """One request exceeds a limit; retrying cannot help."""

    code, http_status, grpc_status = "too_large", 413, "RESOURCE_EXHAUSTED"


class Overloaded(ServiceError):
    """A bounded queue or table is full; retry after `retry_after_s`."""

    code, http_status, grpc_status = "overloaded", 429, "RESOURCE_EXHAUSTED"

    def __init__(self, detail: str, *, field: str = "", hint: str = "", retry_after_s: float | None = 1.0) -> None:
        super().__init__(detail, field=field, hint=hint, retry_after_s=retry_after_s)


class Cancelled(ServiceError):
    """The client disconnected before the reply."""

    code, http_status, grpc_status = "cancelled", 499, "CANCELLED"


class Internal(ServiceError):
    """A bug in freerein; the log holds the traceback under the same request id."""


class Unimplemented(ServiceError):
    """This world or model does not support the call."""

    code, http_status, grpc_status = "unimplemented", 501, "UNIMPLEMENTED"


class Unavailable(ServiceError):
    """Not ready, or draining; another replica or a retry may succeed."""

    code, http_status, grpc_status = "unavailable", 503, "UNAVAILABLE"

    def __init__(self, detail: str, *, field: str = "", hint: str = "", retry_after_s: float | None = 1.0) -> None:
        super().__init__(detail, field=field, hint=hint, retry_after_s=retry_after_s)


class OutOfStorage(ServiceError):
    """The disk is full, broken or read-only; the same call succeeds once it can be written."""

    code, http_status, grpc_status = "out_of_storage", 507, "UNAVAILABLE"


class ModelFault(Unavailable):
    """The model raised, or returned a wrong shape."""

    code = "model_fault"


class DeadlineExceeded(ServiceError):
    """The reply was not ready before the deadline."""

    code, http_status, grpc_status = "deadline_exceeded", 504, "DEADLINE_EXCEEDED"


def _subclasses(parent: type[ServiceError]) -> Iterator[type[ServiceError]]:
    yield parent
    for child in parent.__subclasses__():
        yield from _subclasses(child)


def by_code(code: str) -> type[ServiceError]:
    """Returns the class of an error code, `Internal` for an unknown one."""
    return next((cls for cls in _subclasses(ServiceError) if cls.code == code and cls is not ServiceError), Internal)
