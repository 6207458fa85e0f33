"""Calls the orchestrator."""

import uuid
from collections.abc import AsyncGenerator
from dataclasses import replace
from functools import cached_property

from freerein.api.orchestrator.v1 import orchestrator_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types import orchestrator


class OrchestratorClient(Client):
    """Starts and watches runs. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "orchestrator_pb2_grpc.OrchestratorServiceAsyncStub":
        return orchestrator_pb2_grpc.OrchestratorServiceStub(self._channel.grpc)

    async def start_run(
        self, request: orchestrator.StartRunRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.StartRunResponse:
        """Queues a run; a request without an idempotency key gets one, so that it may be retried."""
        keyed = replace(request, idempotency_key=request.idempotency_key or uuid.uuid4().hex)
        return await self._channel.unary(self._stub.StartRun, keyed, orchestrator.StartRunResponse, timeout_s=timeout_s)

    async def get_run(
        self, request: orchestrator.GetRunRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.GetRunResponse:
        """Returns one run."""
        return await self._channel.unary(self._stub.GetRun, request, orchestrator.GetRunResponse, timeout_s=timeout_s)

    async def list_runs(
        self, request: orchestrator.ListRunsRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.ListRunsResponse:
        """Returns one page of the runs, newest first."""
        return await self._channel.unary(
            self._stub.ListRuns, request, orchestrator.ListRunsResponse, timeout_s=timeout_s
        )

    def watch_run(
        self, request: orchestrator.WatchRunRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[orchestrator.WatchRunResponse, None]:
        """Returns an iterator over the events of a run, which ends when the run has ended."""
        return self._channel.server_stream(
            self._stub.WatchRun, request, orchestrator.WatchRunResponse, timeout_s=timeout_s
        )

    async def get_metrics(
        self, request: orchestrator.GetMetricsRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.GetMetricsResponse:
        """Returns the metrics of a run from a step on, decimated to a number of rows."""
        return await self._channel.unary(
            self._stub.GetMetrics, request, orchestrator.GetMetricsResponse, timeout_s=timeout_s
        )

    async def cancel_run(
        self, request: orchestrator.CancelRunRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.CancelRunResponse:
        """Cancels a run."""
        return await self._channel.unary(
            self._stub.CancelRun, request, orchestrator.CancelRunResponse, timeout_s=timeout_s
        )

    async def resume_run(
        self, request: orchestrator.ResumeRunRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.ResumeRunResponse:
        """Queues a failed or cancelled run again."""
        return await self._channel.unary(
            self._stub.ResumeRun, request, orchestrator.ResumeRunResponse, timeout_s=timeout_s
        )

    async def list_artifacts(
        self, request: orchestrator.ListArtifactsRequest, *, timeout_s: float = DEADLINE_S
    ) -> orchestrator.ListArtifactsResponse:
        """Lists the artifacts of a run."""
        return await self._channel.unary(
            self._stub.ListArtifacts, request, orchestrator.ListArtifactsResponse, timeout_s=timeout_s
        )

    def get_artifact(
        self, request: orchestrator.GetArtifactRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[orchestrator.GetArtifactResponse, None]:
        """Returns an iterator over the parts of one artifact."""
        return self._channel.server_stream(
            self._stub.GetArtifact, request, orchestrator.GetArtifactResponse, timeout_s=timeout_s
        )
