"""Calls the imitation service."""

from collections.abc import AsyncGenerator, AsyncIterator
from functools import cached_property

from freerein.api.imitation.v1 import imitation_pb2_grpc
from freerein.clients.channel import DEADLINE_S, Client
from freerein.types.imitation import (
    ActRequest,
    ActResponse,
    ControlRequest,
    ControlResponse,
    GetSpecRequest,
    GetSpecResponse,
)


class ImitationClient(Client):
    """Acts towards goals. Every call raises `freerein.errors.ServiceError` when it fails."""

    @cached_property
    def _stub(self) -> "imitation_pb2_grpc.ImitationServiceAsyncStub":
        return imitation_pb2_grpc.ImitationServiceStub(self._channel.grpc)

    async def get_spec(self, request: GetSpecRequest, *, timeout_s: float = DEADLINE_S) -> GetSpecResponse:
        """Returns what a model wants to see and what its actions mean."""
        return await self._channel.unary(self._stub.GetSpec, request, GetSpecResponse, timeout_s=timeout_s)

    async def act(self, request: ActRequest, *, timeout_s: float = DEADLINE_S) -> ActResponse:
        """Returns the next actions, and the state that the next call brings back."""
        return await self._channel.unary(self._stub.Act, request, ActResponse, timeout_s=timeout_s)

    def control(
        self, requests: AsyncIterator[ControlRequest], *, timeout_s: float | None = None
    ) -> AsyncGenerator[ControlResponse, None]:
        """Returns an iterator over what a control stream answers.

        First the spec; then a chunk or an error for each observation that no newer one overtook. Nothing is retried; a
        reply with `draining` answers nothing.
        """
        return self._channel.stream(self._stub.Control, requests, ControlResponse, timeout_s=timeout_s)
