"""Calls `FitService` and `ModelService`, which every learned service has."""

import uuid
from collections.abc import AsyncGenerator
from dataclasses import replace
from functools import cached_property

from freerein.api.learning.v1 import learning_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.learning import (
    ActivateModelRequest,
    ActivateModelResponse,
    CancelFitRequest,
    CancelFitResponse,
    GetFitMetricsRequest,
    GetFitMetricsResponse,
    GetFitRequest,
    GetFitResponse,
    ListFitsRequest,
    ListFitsResponse,
    ListModelsRequest,
    ListModelsResponse,
    StartFitRequest,
    StartFitResponse,
    WatchFitRequest,
    WatchFitResponse,
)


class FitClient(Client):
    """Fits models. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "learning_pb2_grpc.FitServiceAsyncStub":
        return learning_pb2_grpc.FitServiceStub(self._channel.grpc)

    async def start_fit(self, request: StartFitRequest, *, timeout_s: float = DEADLINE_S) -> StartFitResponse:
        """Queues a fit; a request without an idempotency key gets one, so that it may be retried."""
        keyed = replace(request, idempotency_key=request.idempotency_key or uuid.uuid4().hex)
        return await self._channel.unary(self._stub.StartFit, keyed, StartFitResponse, timeout_s=timeout_s)

    async def get_fit(self, request: GetFitRequest, *, timeout_s: float = DEADLINE_S) -> GetFitResponse:
        """Returns one fit."""
        return await self._channel.unary(self._stub.GetFit, request, GetFitResponse, timeout_s=timeout_s)

    async def list_fits(self, request: ListFitsRequest, *, timeout_s: float = DEADLINE_S) -> ListFitsResponse:
        """Returns one page of the fits, newest first."""
        return await self._channel.unary(self._stub.ListFits, request, ListFitsResponse, timeout_s=timeout_s)

    def watch_fit(
        self, request: WatchFitRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[WatchFitResponse, None]:
        """Returns an iterator over the events of a fit, which ends when the fit has ended."""
        return self._channel.server_stream(self._stub.WatchFit, request, WatchFitResponse, timeout_s=timeout_s)

    async def get_fit_metrics(
        self, request: GetFitMetricsRequest, *, timeout_s: float = DEADLINE_S
    ) -> GetFitMetricsResponse:
        """Returns the metrics of a fit from a step on, decimated to a number of rows."""
        return await self._channel.unary(self._stub.GetFitMetrics, request, GetFitMetricsResponse, timeout_s=timeout_s)

    async def cancel_fit(self, request: CancelFitRequest, *, timeout_s: float = DEADLINE_S) -> CancelFitResponse:
        """Cancels a fit."""
        return await self._channel.unary(self._stub.CancelFit, request, CancelFitResponse, timeout_s=timeout_s)


class ModelClient(Client):
    """Lists and activates models. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "learning_pb2_grpc.ModelServiceAsyncStub":
        return learning_pb2_grpc.ModelServiceStub(self._channel.grpc)

    async def list_models(self, request: ListModelsRequest, *, timeout_s: float = DEADLINE_S) -> ListModelsResponse:
        """Returns every version of every model."""
        return await self._channel.unary(self._stub.ListModels, request, ListModelsResponse, timeout_s=timeout_s)

    async def activate_model(
        self, request: ActivateModelRequest, *, timeout_s: float = DEADLINE_S
    ) -> ActivateModelResponse:
        """Makes a version the active one."""
        return await self._channel.unary(self._stub.ActivateModel, request, ActivateModelResponse, timeout_s=timeout_s)
