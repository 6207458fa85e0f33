"""The connection to one service: a dataclass goes out as a message, and an answer or an error comes back.

    dataclass -- wire.pack --> message == gRPC ==> message  -- wire.unpack --> dataclass
                                               ==> AioRpcError -- grpc_errors --> ServiceError

It is the one place where a call gets its deadline, its token and its request id.
"""

import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar, cast

import grpc
from google.protobuf.message import Message
from grpc import aio

from freerein import wire
from freerein.clients import retries
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
    # A service that hangs is noticed 11 s after it last spoke. It is the ping's own timeout, 60 s unless told
    # otherwise, that counts; and long calls send no data, so pings without data must not be rationed.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 1_000),
    ("grpc.http2.ping_timeout_ms", 1_000),
    ("grpc.http2.max_pings_without_data", 0),
    # Probes of the bandwidth are pings, too, whose answers queue behind the data that they measure: on a thin line they
    # would time out. Without them the window is as large as they might have made it.
    ("grpc.http2.bdp_probe", 0),
    ("grpc.http2.lookahead_bytes", 4 * 2**20),
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
        """Returns an iterator over the answers to one request; as `unary`. Closing it ends the call."""
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
        """Returns an iterator over the answers to a stream of requests; as `server_stream`."""
        call = _Call(f"The stream to {self.address}", uuid.uuid4().hex)
        messages = (cast(Sent, _packed(request)) async for request in requests)
        return _replies(lambda: method(messages, timeout=timeout_s, metadata=self._metadata(call)), reply, call)

    def _metadata(self, call: "_Call") -> tuple[tuple[str, str], ...]:
        return (("x-request-id", call.request_id), *self._authorization)


@dataclass(frozen=True)
class _Call:
    """One call, as its errors tell of it."""

    name: str
    request_id: str

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Raises gRPC's errors as ours."""
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
    stream = begin()  # not before somebody iterates: who does not has no call to end
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
