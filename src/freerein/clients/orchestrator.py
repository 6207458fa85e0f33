"""Calls the orchestrator."""

import uuid
from collections.abc import AsyncGenerator
from dataclasses import replace
from functools import cached_property

from freerein.api.orchestrator.v1 import orchestrator_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.orchestrator import (
    CancelRunRequest,
    CancelRunResponse,
    GetArtifactRequest,
    GetArtifactResponse,
    GetMetricsRequest,
    GetMetricsResponse,
    GetRunRequest,
    GetRunResponse,
    ListArtifactsRequest,
    ListArtifactsResponse,
    ListRunsRequest,
    ListRunsResponse,
    ResumeRunRequest,
    ResumeRunResponse,
    StartRunRequest,
    StartRunResponse,
    WatchRunRequest,
    WatchRunResponse,
)


class OrchestratorClient(Client):
    """Starts and watches runs. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "orchestrator_pb2_grpc.OrchestratorServiceAsyncStub":
        return orchestrator_pb2_grpc.OrchestratorServiceStub(self._channel.grpc)

    async def start_run(self, request: StartRunRequest, *, timeout_s: float = DEADLINE_S) -> StartRunResponse:
        """Queues a run; a request without an idempotency key gets one, so that it may be retried."""
        keyed = replace(request, idempotency_key=request.idempotency_key or uuid.uuid4().hex)
        return await self._channel.unary(self._stub.StartRun, keyed, StartRunResponse, timeout_s=timeout_s)

    async def get_run(self, request: GetRunRequest, *, timeout_s: float = DEADLINE_S) -> GetRunResponse:
        """Returns one run."""
        return await self._channel.unary(self._stub.GetRun, request, GetRunResponse, timeout_s=timeout_s)

    async def list_runs(self, request: ListRunsRequest, *, timeout_s: float = DEADLINE_S) -> ListRunsResponse:
        """Returns one page of the runs, newest first."""
        return await self._channel.unary(self._stub.ListRuns, request, ListRunsResponse, timeout_s=timeout_s)

    def watch_run(
        self, request: WatchRunRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[WatchRunResponse, None]:
        """Returns an iterator over the events of a run, which ends when the run has ended."""
        return self._channel.server_stream(self._stub.WatchRun, request, WatchRunResponse, timeout_s=timeout_s)

    async def get_metrics(self, request: GetMetricsRequest, *, timeout_s: float = DEADLINE_S) -> GetMetricsResponse:
        """Returns the metrics of a run from a step on, decimated to a number of rows."""
        return await self._channel.unary(self._stub.GetMetrics, request, GetMetricsResponse, timeout_s=timeout_s)

    async def cancel_run(self, request: CancelRunRequest, *, timeout_s: float = DEADLINE_S) -> CancelRunResponse:
        """Cancels a run."""
        return await self._channel.unary(self._stub.CancelRun, request, CancelRunResponse, timeout_s=timeout_s)

    async def resume_run(self, request: ResumeRunRequest, *, timeout_s: float = DEADLINE_S) -> ResumeRunResponse:
        """Queues a failed or cancelled run again."""
        return await self._channel.unary(self._stub.ResumeRun, request, ResumeRunResponse, timeout_s=timeout_s)

    async def list_artifacts(
        self, request: ListArtifactsRequest, *, timeout_s: float = DEADLINE_S
    ) -> ListArtifactsResponse:
        """Lists the artifacts of a run."""
        return await self._channel.unary(self._stub.ListArtifacts, request, ListArtifactsResponse, timeout_s=timeout_s)

    def get_artifact(
        self, request: GetArtifactRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[GetArtifactResponse, None]:
        """Returns an iterator over the parts of one artifact."""
        return self._channel.server_stream(self._stub.GetArtifact, request, GetArtifactResponse, timeout_s=timeout_s)
