"""The connection to one service, and the one place where a call gets its deadline, token and request id.

    dataclass --wire.pack--> message --gRPC--> message --wire.unpack--> dataclass
                                 |
                                 +--> freerein.errors
"""

import uuid
from collections.abc import AsyncIterator
from types import TracebackType
from typing import Self, TypeVar, cast

import grpc
from google.protobuf.message import Message
from grpc import aio

from freerein import wire
from freerein.clients import retries
from freerein.clients.grpc_errors import service_error
from freerein.errors import Internal, InvalidInput, ServiceError, TooLarge

DEADLINE_S = 30.0
MAX_MESSAGE_BYTES = 64 * 2**20

T = TypeVar("T")
Sent = TypeVar("Sent", bound=Message)
Received = TypeVar("Received", bound=Message)

_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    # A service that hangs is noticed 11 s after it last spoke. It is the ping's own timeout, 60 s unless told
    # otherwise, that counts; and long calls send no data, so pings without data must not be rationed.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 1_000),
    ("grpc.http2.ping_timeout_ms", 1_000),
    ("grpc.http2.max_pings_without_data", 0),
    # A service that comes back, here or at another address of the same name, is found within seconds.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    ("grpc.dns_min_time_between_resolutions_ms", 5_000),
    # A request that is larger than this buffer would not be retried.
    ("grpc.per_rpc_retry_buffer_size", MAX_MESSAGE_BYTES),
)


class Channel:
    """A connection to the gRPC door of one service, opened by the first call and bound to that call's event loop.

    Args:
        address: `host:port`.
        token: Sent as Bearer with every call; empty for none.
        root_certificates: PEM certificates that the service's TLS certificate must descend from; None for no TLS.
    """

    def __init__(self, address: str, *, token: str = "", root_certificates: bytes | None = None) -> None:
        self.address = address
        self._authorization = (("authorization", f"Bearer {token}"),) if token else ()
        self._root_certificates = root_certificates
        self._grpc: aio.Channel | None = None

    @property
    def grpc(self) -> aio.Channel:
        """The gRPC channel; call within a running event loop."""
        if self._grpc is None:
            options = (*_OPTIONS, ("grpc.service_config", retries.service_config()))
            if self._root_certificates is None:
                self._grpc = aio.insecure_channel(self.address, options)
            else:
                credentials = grpc.ssl_channel_credentials(self._root_certificates)
                self._grpc = aio.secure_channel(self.address, credentials, options)
        return self._grpc

    async def close(self) -> None:
        """Ends the calls in flight and closes the connection."""
        if self._grpc is not None:
            await self._grpc.close()

    async def unary(
        self,
        method: "aio.UnaryUnaryMultiCallable[Sent, Received]",
        request: object,
        reply: type[T],
        *,
        timeout_s: float,
    ) -> T:
        """Returns the answer to one request.

        Args:
            method: The call, from a generated stub on `grpc`.
            request: The request's dataclass.
            reply: The answer's dataclass.
            timeout_s: Deadline, in seconds from now, of all attempts together.

        Raises:
            ServiceError: The service refused the request, could not be reached or did not answer in time.
        """
        message = cast(Sent, _packed(request))
        call = _Call(f"{_verb(request)} at {self.address}")
        try:
            received = await method(message, timeout=timeout_s, metadata=(*self._authorization, *call.metadata))
        except aio.AioRpcError as error:
            raise call.error(error) from error
        return _unpacked(received, reply)

    async def server_stream(
        self,
        method: "aio.UnaryStreamMultiCallable[Sent, Received]",
        request: object,
        reply: type[T],
        *,
        timeout_s: float | None,
    ) -> AsyncIterator[T]:
        """Yields the answers to one request; as `unary`. Closing the iterator ends the call."""
        message = cast(Sent, _packed(request))
        call = _Call(f"{_verb(request)} at {self.address}")
        stream = method(message, timeout=timeout_s, metadata=(*self._authorization, *call.metadata))
        async for item in _received(stream, call, reply):
            yield item

    async def both_streams(
        self,
        method: "aio.StreamStreamMultiCallable[Sent, Received]",
        requests: AsyncIterator[object],
        reply: type[T],
        *,
        timeout_s: float | None,
    ) -> AsyncIterator[T]:
        """Yields answers to many requests on one stream; as `server_stream`."""
        call = _Call(f"A stream to {self.address}")
        messages = (cast(Sent, _packed(request)) async for request in requests)
        stream = method(messages, timeout=timeout_s, metadata=(*self._authorization, *call.metadata))
        async for item in _received(stream, call, reply):
            yield item
