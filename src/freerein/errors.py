"""The errors that may cross a boundary of freerein, and nothing else may.

    ServiceError
    ├── MalformedRequest      400  INVALID_ARGUMENT     the bytes are not a request
    ├── InvalidInput          422  INVALID_ARGUMENT     a request, but a value is wrong
    │   └── OutputNotFinite   422  INVALID_ARGUMENT     finite input overflowed the model
    ├── UnsupportedMedia      415  INVALID_ARGUMENT     a content type, encoding or image format that is not served
    ├── Unauthenticated       401  UNAUTHENTICATED
    ├── NotFound              404  NOT_FOUND
    │   └── SessionNotFound   404  NOT_FOUND            the session was never made, was closed, or its lease has ended
    ├── AlreadyExists         409  ALREADY_EXISTS
    ├── FailedPrecondition    409  FAILED_PRECONDITION  the thing is not in the state that this call needs
    │   └── StepOutOfOrder    409  FAILED_PRECONDITION  a step that does not follow the session's last
    ├── WorkerLost            409  ABORTED              the process that held the session is gone
    ├── TooLarge              413  RESOURCE_EXHAUSTED   a single request over a limit: retrying cannot help
    ├── Overloaded            429  RESOURCE_EXHAUSTED   too much at once: retry after `retry_after_s`
    ├── Cancelled             499  CANCELLED            the caller went away
    ├── Internal              500  INTERNAL             a bug of ours
    ├── Unimplemented         501  UNIMPLEMENTED
    ├── Unavailable           503  UNAVAILABLE          not ready, or draining
    │   └── ModelFault        503  UNAVAILABLE          the model raised or answered nonsense
    └── DeadlineExceeded      504  DEADLINE_EXCEEDED

Plain strings and ints only: `freerein.serving` maps them to HTTP and gRPC, `freerein.clients` maps them back. Every
`detail` is one sentence that says what was expected and what came; `hint` says how to mend it. Neither ever holds a
path, a traceback, a repr or an echo of the input.
"""

from collections.abc import Iterator


class ServiceError(Exception):
    """An error that its caller can read and act on.

    Args:
        detail: One sentence: what was expected, what came.
        field: Dotted name of the request's field at fault, empty when there is none.
        hint: How to mend it.
        retry_after_s: When trying again may help, in seconds; None when it cannot.
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


class MalformedRequest(ServiceError):
    """The bytes could not be read as a request."""

    code, http_status, grpc_status = "malformed_request", 400, "INVALID_ARGUMENT"


class InvalidInput(ServiceError):
    """A value of the request is wrong."""

    code, http_status, grpc_status = "invalid_input", 422, "INVALID_ARGUMENT"


class OutputNotFinite(InvalidInput):
    """The model's output overflowed on this input."""

    code = "output_not_finite"


class UnsupportedMedia(ServiceError):
    """A content type, content encoding or image format that is not served."""

    code, http_status, grpc_status = "unsupported_media", 415, "INVALID_ARGUMENT"


class Unauthenticated(ServiceError):
    """The token is missing or wrong."""

    code, http_status, grpc_status = "unauthenticated", 401, "UNAUTHENTICATED"


class NotFound(ServiceError):
    """There is no such session, fit, model, task, dataset or route."""

    code, http_status, grpc_status = "not_found", 404, "NOT_FOUND"


class SessionNotFound(NotFound):
    """The session was never made, was closed, or its lease has ended."""

    code = "session_not_found"


class AlreadyExists(ServiceError):
    """The name or idempotency key is taken by something different."""

    code, http_status, grpc_status = "already_exists", 409, "ALREADY_EXISTS"


class FailedPrecondition(ServiceError):
    """The thing exists, but is not in the state that this call needs."""

    code, http_status, grpc_status = "failed_precondition", 409, "FAILED_PRECONDITION"


class StepOutOfOrder(FailedPrecondition):
    """The `step_id` does not follow the session's last step."""

    code = "step_out_of_order"


class WorkerLost(ServiceError):
    """The process that held the session is gone, and the session with it."""

    code, http_status, grpc_status = "worker_lost", 409, "ABORTED"


class TooLarge(ServiceError):
    """One request is over a limit; sending it again cannot help."""

    code, http_status, grpc_status = "too_large", 413, "RESOURCE_EXHAUSTED"


class Overloaded(ServiceError):
    """A bounded queue or table is full; try again after `retry_after_s`."""

    code, http_status, grpc_status = "overloaded", 429, "RESOURCE_EXHAUSTED"

    def __init__(self, detail: str, *, field: str = "", hint: str = "", retry_after_s: float | None = 1.0) -> None:
        super().__init__(detail, field=field, hint=hint, retry_after_s=retry_after_s)


class Cancelled(ServiceError):
    """The caller went away before the work was done."""

    code, http_status, grpc_status = "cancelled", 499, "CANCELLED"


class Internal(ServiceError):
    """A bug of ours; the log holds the traceback under the same request id."""


class Unimplemented(ServiceError):
    """This world or model cannot do that."""

    code, http_status, grpc_status = "unimplemented", 501, "UNIMPLEMENTED"


class Unavailable(ServiceError):
    """Not ready yet, or draining; another replica or a later try may answer."""

    code, http_status, grpc_status = "unavailable", 503, "UNAVAILABLE"

    def __init__(self, detail: str, *, field: str = "", hint: str = "", retry_after_s: float | None = 1.0) -> None:
        super().__init__(detail, field=field, hint=hint, retry_after_s=retry_after_s)


class ModelFault(Unavailable):
    """The model raised, or answered with the wrong shape."""

    code = "model_fault"


class DeadlineExceeded(ServiceError):
    """The answer did not come before the caller's deadline."""

    code, http_status, grpc_status = "deadline_exceeded", 504, "DEADLINE_EXCEEDED"


def _subclasses(parent: type[ServiceError]) -> Iterator[type[ServiceError]]:
    yield parent
    for child in parent.__subclasses__():
        yield from _subclasses(child)


def by_code(code: str) -> type[ServiceError]:
    """Returns the class whose `code` is given, `Internal` for one that this version does not know."""
    return next((cls for cls in _subclasses(ServiceError) if cls.code == code and cls is not ServiceError), Internal)
