"""RPCs as typed methods of a client: dataclasses are sent as messages, responses returned as dataclasses, or raised.

    dataclass -- wire.pack --> message == gRPC ==> message  -- wire.unpack --> dataclass
                                               ==> AioRpcError -- grpc_errors --> ServiceError

Every call gets its deadline, token and request id here.
"""

import asyncio
import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Generator, Iterator, Sequence
from contextlib import aclosing, contextmanager
from copy import copy
from dataclasses import replace
from operator import methodcaller
from types import TracebackType
from typing import TYPE_CHECKING, Any, Generic, Protocol, SupportsFloat, TypeVar, cast, overload

from google.protobuf.descriptor import MethodDescriptor
from google.protobuf.message import Message
from grpc import aio
from typing_extensions import Self

from freerein import wire
from freerein.clients.channel import MAX_MESSAGE_BYTES, Channel
from freerein.clients.grpc_errors import service_error
from freerein.clients.stream_responses import stream_responses
from freerein.errors import Internal, InvalidInput, ServiceError, TooLarge, must_be

if TYPE_CHECKING:
    from freerein.clients.sync_client import SyncClient

DEADLINE_S = 30.0
_LONGEST_S = 1e9

Request = TypeVar("Request")
Response = TypeVar("Response")
Blocking = TypeVar("Blocking")
Sent_contra = TypeVar("Sent_contra", contravariant=True)
Reply_co = TypeVar("Reply_co", covariant=True)


class Client:
    """A client of one gRPC service, with an `Rpc` for each RPC.

    Args:
        channel: The connection; clients of one address may share it.
    """

    def __init__(self, channel: Channel) -> None:
        self.channel = channel

    async def close(self) -> None:
        """Closes the channel."""
        await self.channel.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        await self.close()


class BlockingCall(Protocol[Sent_contra, Reply_co]):
    """The method that a `SyncClient` has for an RPC."""

    def __call__(self, request: Sent_contra, /, *, timeout_s: float | None = ...) -> Reply_co:
        """Sends a request and returns the reply."""


class Rpc(Generic[Request, Response, Blocking]):
    """One RPC, as an attribute of a client's class; on an instance it is a method.

    Args:
        request: Dataclass of the request; it has the RPC's name and the suffix `Request`.
        response: Dataclass of the response.
    """

    _channel: Channel

    def __init__(self, request: type[Request], response: type[Response]) -> None:
        self.response = response
        self.descriptor = _method_of(request)

    def __set_name__(self, owner: type[Client], name: str) -> None:
        self._attribute = name

    @overload
    def __get__(self, client: None, owner: type[Client]) -> Self: ...
    @overload
    def __get__(self, client: "SyncClient", owner: type[Client]) -> Blocking: ...
    @overload
    def __get__(self, client: Client, owner: type[Client]) -> Self: ...
    def __get__(self, client: Client | None, owner: type[Client]) -> Any:
        if client is None:
            return self
        bound = self.bound_to(client.channel)
        client.__dict__[self._attribute] = bound  # as `cached_property`: found there from now on
        return bound

    def bound_to(self, channel: Channel) -> Self:
        """Returns the RPC as a method over a channel."""
        bound = copy(self)
        bound._channel = channel
        return bound

    @property
    def _grpc_call(self) -> Any:
        """The method of the gRPC channel."""
        methods, channel, name = self._channel.methods, self._channel.grpc, self.descriptor.full_name
        if name not in methods:
            methods[name] = self._grpc_method(channel)
        return methods[name]

    def _grpc_method(self, channel: aio.Channel) -> Any:
        rpc = self.descriptor
        sent, received = ("stream" if streams else "unary" for streams in (rpc.client_streaming, rpc.server_streaming))
        return getattr(channel, f"{sent}_{received}")(
            f"/{rpc.containing_service.full_name}/{rpc.name}",
            request_serializer=methodcaller("SerializeToString"),
            response_deserializer=wire.message_type(self.response).FromString,
        )

    @contextmanager
    def _errors(self, request_id: str) -> Iterator[None]:
        """Translates gRPC's errors."""
        try:
            yield
        except aio.AioRpcError as error:
            call = f"{self.descriptor.name} at {self._channel.address}"
            raised = service_error(error, call=call, proxy=self._channel.proxy)
            if raised.hint:
                raised.add_note(f"Hint: {raised.hint}")
            raised.add_note(f"Request id: {request_id}")
            raise raised from error

    async def _stream(
        self, sent: Message | AsyncIterator[Message], timeout_s: float | None, failures: Sequence[Exception] = ()
    ) -> AsyncGenerator[Response, None]:
        """Yields the responses; a call that ends in an error raises the first of `failures`, if any, instead."""
        request_id, timeout_s = uuid.uuid4().hex, _deadline(timeout_s)
        # Begun only when iterated, so that an unused iterator leaves no call open.
        stream = self._grpc_call(sent, timeout=timeout_s, metadata=self._channel.metadata(request_id))
        try:
            with self._errors(request_id):
                async with aclosing(stream_responses(stream)) as responses:
                    async for received in responses:
                        yield self._unpacked(received)
        except (asyncio.CancelledError, ServiceError):
            if failures:
                raise failures[0] from None
            raise
        finally:
            stream.cancel()
            if requests := getattr(stream, "_async_request_poller", None):
                requests.cancel()  # gRPC would take one more of a call that the service has ended

    def _unpacked(self, message: Message) -> Response:
        try:
            return wire.unpack(message, self.response)
        except InvalidInput as error:
            raise Internal(
                f"The service's reply cannot be read: {error.detail}",
                hint="Use the client and the service of one version.",
            ) from error


class UnaryRpc(Rpc[Request, Response, BlockingCall[Request, Response]]):
    """An RPC with one response."""

    async def __call__(self, request: Request, *, timeout_s: float | None = DEADLINE_S) -> Response:
        """Sends one request and returns the response.

        Args:
            request: The request; an empty `idempotency_key` is filled in, so that the call can be retried.
            timeout_s: Deadline of all attempts together, in seconds; None or infinity for none.

        Raises:
            InvalidInput: `timeout_s` is no number above 0.
            FailedPrecondition: The client is closed, or was used in another event loop before.
            ServiceError: The service refused the request, could not be reached or did not answer in time.
        """
        request_id, timeout = uuid.uuid4().hex, _deadline(timeout_s)
        message = _packed(_keyed(request))
        with self._errors(request_id):
            received = await self._grpc_call(message, timeout=timeout, metadata=self._channel.metadata(request_id))
        return self._unpacked(received)


class ServerStreamRpc(Rpc[Request, Response, BlockingCall[Request, Generator[Response, None, None]]]):
    """An RPC with a stream of responses to one request."""

    def __call__(self, request: Request, *, timeout_s: float | None = None) -> AsyncGenerator[Response, None]:
        """Returns an iterator over the responses; closing it cancels the call. Otherwise as `UnaryRpc`."""
        return self._stream(_packed(request), timeout_s)


class StreamRpc(Rpc[Request, Response, BlockingCall[AsyncIterator[Request], Generator[Response, None, None]]]):
    """An RPC with a stream of responses to a stream of requests."""

    def __call__(
        self, requests: AsyncIterator[Request], *, timeout_s: float | None = None
    ) -> AsyncGenerator[Response, None]:
        """Returns an iterator over the responses; as `ServerStreamRpc`. It raises what `requests` raises."""
        failures: list[Exception] = []
        return self._stream(_packed_each(requests, failures), timeout_s, failures)


def _deadline(timeout_s: float | None) -> float | None:
    """Returns a caller's timeout as gRPC takes it, which ends calls at once that may take too many years."""
    if timeout_s is None:
        return None
    if isinstance(timeout_s, bool) or not isinstance(timeout_s, SupportsFloat) or not float(timeout_s) > 0:
        hint = f"Leave it out for {DEADLINE_S:g} s."
        raise must_be("timeout_s", "seconds above 0, or None for no deadline", _shown(timeout_s), hint=hint)
    return float(timeout_s) if timeout_s <= _LONGEST_S else None


def _shown(timeout_s: object) -> str:
    return f"{float(timeout_s):g}" if isinstance(timeout_s, SupportsFloat) else f"a {type(timeout_s).__name__}"


def _method_of(request: type[object]) -> MethodDescriptor:
    message = wire.descriptor_of(request)
    name = request.__name__.removesuffix("Request")
    services = message.file.services_by_name.values()
    return next(method for service in services for method in service.methods if method.name == name)


def _keyed(request: Request) -> Request:
    if getattr(request, "idempotency_key", None) != "":
        return request
    return cast(Request, replace(cast(Any, request), idempotency_key=uuid.uuid4().hex))


async def _packed_each(requests: AsyncIterator[object], failures: list[Exception]) -> AsyncGenerator[Message, None]:
    """Yields messages; an exception is kept in `failures`, since gRPC drops it and cancels the call."""
    try:
        async for request in requests:
            yield _packed(request)
    except Exception as error:
        failures.append(error)
        raise


def _packed(request: object) -> Message:
    message = wire.pack(request)
    if (size := message.ByteSize()) > MAX_MESSAGE_BYTES:
        raise TooLarge(
            f"A request must be at most {MAX_MESSAGE_BYTES} bytes; got {size}.",
            hint="Send a shorter trajectory or smaller frames, or encoded images.",
        )
    return message
