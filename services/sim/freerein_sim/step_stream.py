"""The RPC `Connect`: resets and steps on one bidirectional stream, one reply per message, in order."""

from collections.abc import AsyncIterator
from dataclasses import dataclass

from freerein.errors import InvalidInput, ServiceError
from freerein.serving.health import Health
from freerein.serving.methods import InvalidMessage
from freerein.types.common import Draining, error_message
from freerein.types.sim import ConnectRequest, ConnectResponse
from freerein_sim.core import SimCore


@dataclass(frozen=True)
class StepStream:
    """Serves stepping streams."""

    core: SimCore
    health: Health
    drain_s: float

    async def connect(self, requests: AsyncIterator[ConnectRequest | InvalidMessage]) -> AsyncIterator[ConnectResponse]:
        """Yields a reply to each message; a refused message is answered by an error, and the stream goes on."""
        async for request in self.health.iterate_until_drain(requests):
            yield await self._answer(request)
        if self.health.draining:
            yield ConnectResponse(draining=Draining(self.drain_s))

    async def _answer(self, request: ConnectRequest | InvalidMessage) -> ConnectResponse:
        try:
            if isinstance(request, InvalidMessage):
                raise request.error
            if request.step is not None:
                return ConnectResponse(step=await self.core.step(request.step))
            if request.reset is not None:
                return ConnectResponse(reset=await self.core.reset(request.reset))
            raise InvalidInput("A message must be a step or a reset; it is empty.", hint="Set one of the two.")
        except ServiceError as error:
            return ConnectResponse(error=error_message(error))
