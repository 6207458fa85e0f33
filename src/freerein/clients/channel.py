"""The connection to one service: sends dataclasses as messages and returns responses as dataclasses, or raises.

    dataclass -- wire.pack --> message == gRPC ==> message  -- wire.unpack --> dataclass
                                               ==> AioRpcError -- grpc_errors --> ServiceError

Every call gets its deadline, token and request id here.
"""

import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Self, TypeVar, cast

import grpc
from google.protobuf.message import Message
from grpc import aio

from freerein import wire
from freerein.clients import retry_policy
from freerein.clients.grpc_errors import service_error
from freerein.errors import Internal, InvalidInput, TooLarge

DEADLINE_S = 30.0
MAX_MESSAGE_BYTES = 64 * 2**20

T = TypeVar("T")
Sent = TypeVar("Sent", bound=Message)
Received = TypeVar("Received", bound=Message)

_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.max_send_message_length", MAX_MESSAGE_BYTES),
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    # A service that hangs is detected 11 s after its last message. The ping's own timeout, 60 s by default, counts;
    # long calls send no data, so pings without data must not be limited.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 1_000),
    ("grpc.http2.ping_timeout_ms", 1_000),
    ("grpc.http2.max_pings_without_data", 0),
    # Bandwidth probes are pings, too, whose answers queue behind data and time out on a slow link. Without them the
    # window must be set.
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 4 * 2**20),
    # A service that restarts, possibly at another address of the same name, is found within seconds.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    ("grpc.dns_min_time_between_resolutions_ms", 5_000),
    # A request larger than this buffer is not retried.
    ("grpc.per_rpc_retry_buffer_size", MAX_MESSAGE_BYTES),
)


class Channel:
    """A gRPC connection to one service, opened by the first call and bound to its event loop.

    Args:
        address: `host:port`.
        token: Bearer token; empty for none.
        root_certificates: PEM root certificates for TLS; None for no TLS.
    """

    def __init__(self, address: str, *, token: str = "", root_certificates: bytes | None = None) -> None:
        self.address = address
        self._authorization = (("authorization", f"Bearer {token}"),) if token else ()
        self._root_certificates = root_certificates
        self._grpc: aio.Channel | None = None

    @property
    def grpc(self) -> aio.Channel:
        """The gRPC channel; access within a running event loop."""
        if self._grpc is None:
            options = (*_OPTIONS, ("grpc.service_config", retry_policy.service_config()))
            if self._root_certificates is None:
                self._grpc = aio.insecure_channel(self.address, options)
            else:
                credentials = grpc.ssl_channel_credentials(self._root_certificates)
                self._grpc = aio.secure_channel(self.address, credentials, options)
        return self._grpc

    async def close(self) -> None:
        """Cancels the calls in flight and closes the connection."""
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
        """Sends one request and returns the response.

        Args:
            method: The method of a generated stub.
            request: The request's dataclass.
            reply: The response's dataclass.
            timeout_s: Deadline of all attempts together, in seconds.

        Raises:
            ServiceError: The service refused the request, could not be reached or did not answer in time.
        """
        call = _Call(f"{_verb(request)} at {self.address}", uuid.uuid4().hex)
        message = cast(Sent, _packed(request))
        with call.errors():
            received = await method(message, timeout=timeout_s, metadata=self._metadata(call))
        return _unpacked(received, reply)

    def server_stream(
        self,
        method: "aio.UnaryStreamMultiCallable[Sent, Received]",
        request: object,
        reply: type[T],
        *,
        timeout_s: float | None,
    ) -> AsyncGenerator[T, None]:
        """Returns an iterator over the responses to one request; closing it cancels the call. Otherwise as `unary`."""
        call = _Call(f"{_verb(request)} at {self.address}", uuid.uuid4().hex)
        message = cast(Sent, _packed(request))
        return _replies(lambda: method(message, timeout=timeout_s, metadata=self._metadata(call)), reply, call)

    def stream(
        self,
        method: "aio.StreamStreamMultiCallable[Sent, Received]",
        requests: AsyncIterator[object],
        reply: type[T],
        *,
        timeout_s: float | None,
    ) -> AsyncGenerator[T, None]:
        """Returns an iterator over the responses to a stream of requests; as `server_stream`."""
        call = _Call(f"The stream to {self.address}", uuid.uuid4().hex)
        messages = (cast(Sent, _packed(request)) async for request in requests)
        return _replies(lambda: method(messages, timeout=timeout_s, metadata=self._metadata(call)), reply, call)

    def _metadata(self, call: "_Call") -> tuple[tuple[str, str], ...]:
        return (("x-request-id", call.request_id), *self._authorization)


class Client:
    """A client of one gRPC service.

    Args:
        channel: The connection; clients of one address may share it.
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


@dataclass(frozen=True)
class _Call:
    """Name and request id of a call, for its errors."""

    name: str
    request_id: str

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Translates gRPC's errors."""
        try:
            yield
        except aio.AioRpcError as error:
            raised = service_error(error, call=self.name)
            raised.add_note(f"Request id: {self.request_id}")
            raise raised from error


async def _replies(
    begin: "Callable[[], aio.UnaryStreamCall[Sent, Received] | aio.StreamStreamCall[Sent, Received]]",
    reply: type[T],
    call: _Call,
) -> AsyncGenerator[T, None]:
    stream = begin()  # only when iterated, so that an unused iterator leaves no call open
    try:
        with call.errors():
            async for received in stream:
                yield _unpacked(received, reply)
    finally:
        stream.cancel()


def _verb(request: object) -> str:
    return type(request).__name__.removesuffix("Request")


def _packed(request: object) -> Message:
    message = wire.pack(request)
    if (size := message.ByteSize()) > MAX_MESSAGE_BYTES:
        raise TooLarge(
            f"A request must be at most {MAX_MESSAGE_BYTES} bytes; got {size}.",
            hint="Send a shorter trajectory or smaller frames, or encoded images.",
        )
    return message


def _unpacked(message: Message, reply: type[T]) -> T:
    try:
        return wire.unpack(message, reply)
    except InvalidInput as error:
        raise Internal(
            f"The service's reply cannot be read: {error.detail}",
            hint="Use the client and the service of one version.",
        ) from error
