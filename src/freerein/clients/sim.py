"""Client of the sim service."""

import uuid
from collections.abc import AsyncGenerator, AsyncIterator
from dataclasses import replace
from functools import cached_property

from freerein.api.sim.v1 import sim_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.sim import (
    CloseSessionRequest,
    CloseSessionResponse,
    ConnectRequest,
    ConnectResponse,
    CreateSessionRequest,
    CreateSessionResponse,
    DemonstrateRequest,
    DemonstrateResponse,
    ListTasksRequest,
    ListTasksResponse,
    RenderRequest,
    RenderResponse,
    ResetRequest,
    ResetResponse,
    RestoreRequest,
    RestoreResponse,
    SnapshotRequest,
    SnapshotResponse,
    StepRequest,
    StepResponse,
)


class SimClient(Client):
    """Client of the sim service. Every call raises `freerein.errors.ServiceError` on failure."""

    @cached_property
    def _stub(self) -> "sim_pb2_grpc.SimServiceAsyncStub":
        return sim_pb2_grpc.SimServiceStub(self._channel.grpc)

    async def list_tasks(self, request: ListTasksRequest, *, timeout_s: float = DEADLINE_S) -> ListTasksResponse:
        """Returns the tasks, with their specs."""
        return await self._channel.unary(self._stub.ListTasks, request, ListTasksResponse, timeout_s=timeout_s)

    async def create_session(
        self, request: CreateSessionRequest, *, timeout_s: float = DEADLINE_S
    ) -> CreateSessionResponse:
        """Creates a session; adds an idempotency key if there is none, so that the call can be retried."""
        keyed = replace(request, idempotency_key=request.idempotency_key or uuid.uuid4().hex)
        return await self._channel.unary(self._stub.CreateSession, keyed, CreateSessionResponse, timeout_s=timeout_s)

    async def reset(self, request: ResetRequest, *, timeout_s: float = DEADLINE_S) -> ResetResponse:
        """Begins new episodes."""
        return await self._channel.unary(self._stub.Reset, request, ResetResponse, timeout_s=timeout_s)

    async def step(self, request: StepRequest, *, timeout_s: float = DEADLINE_S) -> StepResponse:
        """Steps every environment of a session once."""
        return await self._channel.unary(self._stub.Step, request, StepResponse, timeout_s=timeout_s)

    def connect(
        self, requests: AsyncIterator[ConnectRequest], *, timeout_s: float | None = None
    ) -> AsyncGenerator[ConnectResponse, None]:
        """Returns an iterator over the replies to a stream of steps and resets, one each, in order.

        A refused message gets a reply with `error`, and the stream goes on; a reply with `draining` is unsolicited. A
        third of a millisecond faster per step than `step`, but without retries and deadlines.
        """
        return self._channel.stream(self._stub.Connect, requests, ConnectResponse, timeout_s=timeout_s)

    async def render(self, request: RenderRequest, *, timeout_s: float = DEADLINE_S) -> RenderResponse:
        """Renders without stepping."""
        return await self._channel.unary(self._stub.Render, request, RenderResponse, timeout_s=timeout_s)

    async def snapshot(self, request: SnapshotRequest, *, timeout_s: float = DEADLINE_S) -> SnapshotResponse:
        """Returns the complete state of a session."""
        return await self._channel.unary(self._stub.Snapshot, request, SnapshotResponse, timeout_s=timeout_s)

    async def restore(self, request: RestoreRequest, *, timeout_s: float = DEADLINE_S) -> RestoreResponse:
        """Restores a snapshot."""
        return await self._channel.unary(self._stub.Restore, request, RestoreResponse, timeout_s=timeout_s)

    def demonstrate(
        self, request: DemonstrateRequest, *, timeout_s: float | None = None
    ) -> AsyncGenerator[DemonstrateResponse, None]:
        """Returns an iterator over recorded trajectories of a scripted policy."""
        return self._channel.server_stream(self._stub.Demonstrate, request, DemonstrateResponse, timeout_s=timeout_s)

    async def close_session(
        self, request: CloseSessionRequest, *, timeout_s: float = DEADLINE_S
    ) -> CloseSessionResponse:
        """Closes a session."""
        return await self._channel.unary(self._stub.CloseSession, request, CloseSessionResponse, timeout_s=timeout_s)
