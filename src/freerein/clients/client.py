"""What all clients are: a channel, and its end."""

from types import TracebackType
from typing import Self

from freerein.clients.channel import Channel


class Client:
    """A client of one gRPC service.

    Args:
        channel: The connection; clients of services at one address may share it.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    async def close(self) -> None:
        """Closes the channel."""
        await self._channel.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()
