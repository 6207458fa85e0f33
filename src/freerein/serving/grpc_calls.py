"""The end of a gRPC call: recorded, and with the status of the error that it raised."""

import contextlib
import uuid
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from typing import Any

import grpc

from freerein.errors import ServiceError
from freerein.serving.call_recorder import CallRecorder
from freerein.serving.error_replies import abort_grpc
from freerein.serving.methods import Method
from freerein.serving.metrics import Metrics

Context = grpc.aio.ServicerContext[Any, Any]


class GrpcCalls:
    """Records the calls of these methods; those of others, such as health checks, it ends in the same way."""

    def __init__(self, methods: Sequence[Method], metrics: Metrics) -> None:
        self._recorders = {
            method.grpc_path: CallRecorder(metrics, "grpc", method.name, is_stream=method.is_stream)
            for method in methods
        }

    @asynccontextmanager
    async def answered(self, path: str, context: Context) -> AsyncIterator[None]:
        """Answers a call, by the block, whose `ServiceError` becomes the call's status."""
        request_id = _request_id(context)
        try:
            with self._record(path, request_id):
                yield
        except ServiceError as error:
            await abort_grpc(context, error, request_id)

    def _record(self, path: str, request_id: str) -> AbstractContextManager[object]:
        recorder = self._recorders.get(path)
        return recorder.record(request_id) if recorder else contextlib.nullcontext()


def _request_id(context: Context) -> str:
    given = dict(context.invocation_metadata() or ()).get("x-request-id", "")
    return str(given)[:64] or uuid.uuid4().hex
