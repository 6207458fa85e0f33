"""`ServiceError`s as gRPC statuses with google.rpc details: ErrorInfo always, RetryInfo when waiting helps.

Texts are short: statuses travel in metadata, of which clients take 8 KiB.
"""

import grpc
from google.protobuf import any_pb2, duration_pb2
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status

from freerein.errors import ServiceError
from freerein.serving.problems import shortened

DOMAIN = "freerein"


async def abort(context: "grpc.aio.ServicerContext[object, object]", error: ServiceError, request_id: str) -> None:
    """Ends a call with an error. Never returns."""
    code, detail = grpc.StatusCode[error.grpc_status], shortened(error.detail)
    status = status_pb2.Status(code=code.value[0], message=detail, details=_details(error, request_id))
    trailing = rpc_status.to_status(status).trailing_metadata
    await context.abort(code, detail, trailing)


def _details(error: ServiceError, request_id: str) -> list[any_pb2.Any]:
    info = error_details_pb2.ErrorInfo(
        reason=error.code,
        domain=DOMAIN,
        metadata={"field": shortened(error.field), "hint": shortened(error.hint), "request_id": request_id},
    )
    details = [any_pb2.Any()]
    details[0].Pack(info)
    if error.retry_after_s is not None:
        delay = duration_pb2.Duration()
        delay.FromNanoseconds(int(error.retry_after_s * 1e9))
        details.append(any_pb2.Any())
        details[1].Pack(error_details_pb2.RetryInfo(retry_delay=delay))
    return details
