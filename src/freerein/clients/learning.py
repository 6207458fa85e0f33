"""Calls `FitService` and `ModelService`, which every learned service has."""

import uuid
from collections.abc import AsyncGenerator
from dataclasses import replace
from functools import cached_property

from freerein.api.learning.v1 import learning_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types import learning


class FitClient(Client):
    """Fits models. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "learning_pb2_grpc.FitServiceAsyncStub":
        return learning_pb2_grpc.FitServiceStub(self._channel.grpc)

    async def start_fit(
        self, request: learning.StartFitRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.StartFitResponse:
        """Queues a fit; a request without an idempotency key gets one, so that it may be retried."""
        keyed = replace(request, idempotency_key=request.idempotency_key or uuid.uuid4().hex)
        return await self._channel.unary(self._stub.StartFit, keyed, learning.StartFitResponse, timeout_s=timeout_s)

    async def get_fit(
        self, request: learning.GetFitRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.GetFitResponse:
        """Returns one fit."""
        return await self._channel.unary(self._stub.GetFit, request, learning.GetFitResponse, timeout_s=timeout_s)

    async def list_fits(
        self, request: learning.ListFitsRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.ListFitsResponse:
        """Returns one page of the fits, newest first."""
        return await self._channel.unary(self._stub.ListFits, request, learning.ListFitsResponse, timeout_s=timeout_s)

    def watch_fit(
        self, request: learning.WatchFitRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[learning.WatchFitResponse, None]:
        """Returns an iterator over the events of a fit, which ends when the fit has ended."""
        return self._channel.server_stream(self._stub.WatchFit, request, learning.WatchFitResponse, timeout_s=timeout_s)

    async def get_fit_metrics(
        self, request: learning.GetFitMetricsRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.GetFitMetricsResponse:
        """Returns the metrics of a fit from a step on, decimated to a number of rows."""
        return await self._channel.unary(
            self._stub.GetFitMetrics, request, learning.GetFitMetricsResponse, timeout_s=timeout_s
        )

    async def cancel_fit(
        self, request: learning.CancelFitRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.CancelFitResponse:
        """Cancels a fit."""
        return await self._channel.unary(self._stub.CancelFit, request, learning.CancelFitResponse, timeout_s=timeout_s)


class ModelClient(Client):
    """Lists and activates models. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "learning_pb2_grpc.ModelServiceAsyncStub":
        return learning_pb2_grpc.ModelServiceStub(self._channel.grpc)

    async def list_models(
        self, request: learning.ListModelsRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.ListModelsResponse:
        """Returns every version of every model."""
        return await self._channel.unary(
            self._stub.ListModels, request, learning.ListModelsResponse, timeout_s=timeout_s
        )

    async def activate_model(
        self, request: learning.ActivateModelRequest, *, timeout_s: float = DEADLINE_S
    ) -> learning.ActivateModelResponse:
        """Makes a version the active one."""
        return await self._channel.unary(
            self._stub.ActivateModel, request, learning.ActivateModelResponse, timeout_s=timeout_s
        )
