"""Admission of gRPC calls: they need the token, a free place, and a message that arrives in time."""

import asyncio
import inspect
from collections.abc import AsyncIterator, Awaitable
from contextlib import ExitStack, aclosing
from functools import cache
from typing import Any, TypeVar

import grpc
from grpc_health.v1 import health_pb2

from freerein.errors import DeadlineExceeded, MalformedRequest, Overloaded, ServiceError
from freerein.serving import auth
from freerein.serving.grpc_calls import Context, GrpcCalls
from freerein.serving.health import Health
from freerein.serving.limits import COPIES, Limits, Slots
from freerein.serving.memory import Memory, Share

_HEALTH_METHODS = f"/{health_pb2.DESCRIPTOR.services_by_name['Health'].full_name}/"
T = TypeVar("T")


class Admission(grpc.aio.ServerInterceptor):
    """Refuses calls without the token, and those above the limits, before their message is read.

    Calls of the health service need no token, and have places of their own. gRPC itself bounds neither how long a
    message takes to arrive nor what all messages hold meanwhile.

    Attributes:
        admitted: Calls admitted so far, without health checks.
    """

    def __init__(self, health: Health, limits: Limits, memory: Memory, *, token: str, calls: GrpcCalls) -> None:
        self.admitted = 0
        self._health = health
        self._memory = memory
        self._token = token
        self._answered = calls.answered
        self._refuses = False
        self._calls = Slots(limits.concurrent_calls, "calls may be in progress")
        self._streams = Slots(limits.streams, "streams may be open")
        self._health_calls = Slots(limits.health_calls, "health checks may be in progress")
        self._watches = Slots(limits.health_calls, "health watches may be open")
        self._receipts = Receipts(limits, memory)
        self._received = cache(self._receive_first)

    async def intercept_service(self, continuation: Any, details: grpc.HandlerCallDetails) -> Any:
        """Returns the handler of a call, or one that refuses it."""
        is_health = details.method.startswith(_HEALTH_METHODS)
        places = ExitStack()
        if call := asyncio.current_task():  # each call is a task of its own
            call.add_done_callback(lambda _: places.close())
        try:
            if not is_health:
                auth.check(str(dict(details.invocation_metadata or ()).get("authorization", "")), self._token)
                self._check_draining()
            handler = await continuation(details)
            is_stream = handler is not None and handler.response_streaming
            if is_health:
                places.enter_context((self._watches if is_stream else self._health_calls).hold())
            else:
                places.enter_context(self._calls.hold())
                if is_stream:
                    places.enter_context(self._streams.hold())
                self.admitted += 1
        except ServiceError as error:
            return self._refusal(error, details.method)
        return handler and self._received(handler, details.method)

    @property
    def in_progress(self) -> int:
        """Calls in progress, without health checks."""
        return self._calls.taken

    def refuse(self) -> None:
        """Refuses new calls from now on."""
        self._refuses = True

    def _check_draining(self) -> None:
        if self._refuses:
            raise self._health.error()

    def _refusal(self, refusal: ServiceError, path: str) -> Any:
        async def refuse(_messages: Any, context: Context) -> None:
            async with self._answered(path, context):
                raise refusal

        return grpc.stream_stream_rpc_method_handler(refuse)

    def _receive_first(self, handler: Any, path: str) -> Any:
        """Returns a handler that answers as another, but refuses a call whose first message is late."""
        answer = next(
            each
            for each in (handler.unary_unary, handler.unary_stream, handler.stream_unary, handler.stream_stream)
            if each is not None
        )

        async def begun(context: Context) -> Any:
            first = await self._receipts.receive(context.read())
            if first is grpc.aio.EOF:
                raise MalformedRequest("A call must send a message; it sent none.", hint="Use a gRPC client.")
            share = self._memory.share_of_task()
            if isinstance(first, bytes):  # not of health and reflection, whose messages are small
                share.take(COPIES * len(first))
            return _stream([first], context, share) if handler.request_streaming else first

        async def call(_messages: Any, context: Context) -> Any:
            async with self._answered(path, context):
                return await answer(await begun(context), context)

        async def generate(_messages: Any, context: Context) -> AsyncIterator[Any]:
            async with self._answered(path, context), aclosing(answer(await begun(context), context)) as responses:
                async for response in responses:
                    yield response

        make = (
            grpc.stream_stream_rpc_method_handler
            if handler.response_streaming
            else grpc.stream_unary_rpc_method_handler
        )
        behaviour: Any = generate if inspect.isasyncgenfunction(answer) else call
        return make(behaviour, handler.request_deserializer, handler.response_serializer)


class Receipts:
    """Receives first messages within a deadline, and a few of them slowly.

    A message can take its greatest size in memory while it arrives, so each that arrives slowly has that of the memory.
    """

    def __init__(self, limits: Limits, memory: Memory) -> None:
        self._limits = limits
        self._memory = memory
        self._slow = Slots(limits.slow_messages, "messages may arrive slowly")

    async def receive(self, message: Awaitable[T]) -> T:
        """Returns a message.

        Raises:
            DeadlineExceeded: It took longer than `receipt_s`.
            Overloaded: It took longer than `slow_receipt_s`, as did too many others.
        """
        loop = asyncio.get_running_loop()
        refusal: ServiceError = DeadlineExceeded(
            f"A message must arrive within {self._limits.receipt_s:g} s; this one did not.",
            hint="Send it faster, or raise FREEREIN_RECEIPT_S for slow lines.",
        )
        slow = ExitStack()

        def take_slow_place() -> None:
            nonlocal refusal
            try:
                slow.enter_context(self._slow.hold())
                slow.enter_context(self._memory.share()).take(self._limits.message_bytes)
            except Overloaded as error:
                refusal = error
                deadline.reschedule(loop.time())

        timer = loop.call_later(self._limits.slow_receipt_s, take_slow_place)
        try:
            with slow:
                async with asyncio.timeout(self._limits.receipt_s) as deadline:
                    return await message
        except TimeoutError:
            raise refusal from None
        finally:
            timer.cancel()


async def _stream(first: list[Any], context: Context, share: Share) -> AsyncIterator[Any]:
    """Yields messages; the first, in a list, may be large, and is neither kept nor counted once it was taken."""
    yield first.pop()
    share.close()
    while (message := await context.read()) is not grpc.aio.EOF:
        yield message
