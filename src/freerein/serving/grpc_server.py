"""The gRPC server of a service: its methods, health and reflection."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import aclosing
from typing import Any

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_health.v1.health import aio as health_aio
from grpc_reflection.v1alpha import reflection

from freerein import wire
from freerein.errors import DeadlineExceeded
from freerein.serving.grpc_admission import Admission
from freerein.serving.grpc_calls import Context, GrpcCalls
from freerein.serving.grpc_messages import decode, decode_part
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.memory import Memory, Share, encode
from freerein.serving.methods import Method, service_names
from freerein.serving.metrics import Metrics

_HEALTH_SERVICE = health_pb2.DESCRIPTOR.services_by_name["Health"].full_name
_HEALTH_PERIOD_S = 0.2
_SENT_BEFORE_S = 0.5  # how long calls that were sent before SIGTERM may take to arrive
_QUIET_S = 0.1
_LOOKAHEAD_BYTES = 4 * 2**20


class GrpcServer:
    """The gRPC server of one service; `server` is the `grpc.aio` server, to bind, start and stop.

    An empty `token` allows every call.
    """

    def __init__(
        self,
        methods: Sequence[Method],
        *,
        health: Health,
        metrics: Metrics,
        limits: Limits,
        memory: Memory | None = None,
        token: str = "",
    ) -> None:
        self._health = health
        self._limits = limits
        self._memory = memory or Memory(limits)
        self._names = service_names(methods)
        self._health_servicer = _HealthServicer(("", *self._names))
        calls = GrpcCalls(methods, metrics)
        self._admission = Admission(health, limits, self._memory, token=token, calls=calls)
        self.server = grpc.aio.server(
            interceptors=[self._admission],
            options=[
                ("grpc.max_concurrent_streams", limits.connection_calls),
                ("grpc.server_handshake_timeout_ms", int(limits.receipt_s * 1000)),
                ("grpc.max_receive_message_length", limits.message_bytes),
                ("grpc.max_send_message_length", limits.message_bytes),
                ("grpc.so_reuseport", 0),  # a port in use is an error
                ("grpc.http2.min_ping_interval_without_data_ms", 500),
                ("grpc.keepalive_permit_without_calls", 1),
                ("grpc.keepalive_time_ms", 10_000),
                ("grpc.http2.ping_timeout_ms", 1_000),
                # Bandwidth probes are pings whose replies queue behind data, so on a slow line they time out. Without
                # them the flow control window is set to the size that they would find.
                ("grpc.http2.bdp_probe", 0),
                ("grpc.http2.lookahead_bytes", _LOOKAHEAD_BYTES),
            ],
        )
        for name in self._names:
            own = [method for method in methods if method.descriptor.containing_service.full_name == name]
            handlers = {method.name: self._handler(method) for method in own}
            self.server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(name, handlers),))
        health_pb2_grpc.add_HealthServicer_to_server(self._health_servicer, self.server)
        reflection.enable_server_reflection((*self._names, _HEALTH_SERVICE, reflection.SERVICE_NAME), self.server)

    async def drain(self) -> None:
        """Waits until the calls in flight have ended, at the latest for `Limits.drain_s`; later calls are refused.

        For a moment it still admits calls, which may have been sent before. The server is not stopped, since gRPC would
        cancel calls that it has not begun: the end of the process makes them UNAVAILABLE.
        """
        loop, admission = asyncio.get_running_loop(), self._admission
        cut_at = loop.time() + self._limits.drain_s
        admitted, admitted_until = -1, loop.time() + _SENT_BEFORE_S
        while admitted != admission.admitted and loop.time() < admitted_until:
            admitted = admission.admitted
            await asyncio.sleep(_QUIET_S)
        admission.refuse()
        while admission.in_progress and loop.time() < cut_at:  # noqa: ASYNC110  # calls end in many ways
            await asyncio.sleep(_QUIET_S)
        await asyncio.sleep(_QUIET_S)  # for the last replies to be sent

    async def report_health(self) -> None:
        """Copies readiness to the standard health service until the graceful shutdown begins."""
        status: int | None = None
        states = health_pb2.HealthCheckResponse
        while not self._health.draining:
            now = states.NOT_SERVING if self._health.reason() else states.SERVING
            if now != status:
                status = now
                for name in ("", *self._names):
                    await self._health_servicer.set(name, status)
            await self._health.await_or_drain(asyncio.sleep(_HEALTH_PERIOD_S))
        await self._health_servicer.enter_graceful_shutdown()

    def _handler(self, method: Method) -> "grpc.RpcMethodHandler[Any, Any]":
        """Returns a handler of raw bytes, so that messages that cannot be parsed are answered with our own error."""
        if method.descriptor.client_streaming:
            return grpc.stream_stream_rpc_method_handler(self._streaming(method))
        if method.descriptor.server_streaming:
            return grpc.unary_stream_rpc_method_handler(self._streaming(method))
        return grpc.unary_unary_rpc_method_handler(self._unary(method))

    def _unary(self, method: Method) -> Callable[[bytes, Context], Awaitable[bytes]]:
        async def answer(message: bytes, context: Context) -> bytes:
            try:
                async with asyncio.timeout(_timeout_s(context, self._limits.unary_s)):
                    response = await method.call(await decode(message, method.request))
                    return await encode(response, _serialised, self._memory.share_of_task())
            except TimeoutError:
                raise DeadlineExceeded("The reply was not ready in time.", hint="Send less per call.") from None

        return answer

    def _streaming(self, method: Method) -> Callable[[Any, Context], Awaitable[None]]:
        async def answer(incoming: Any, context: Context) -> None:
            if method.descriptor.client_streaming:
                request: Any = _decode_stream(incoming, method.request)
            else:
                request = await decode(incoming, method.request)
            async with aclosing(method.call(request)) as responses:
                unread = await self._write_all(responses, context, self._memory.share_of_task())
            if unread is not None:
                await self._end_unread(unread)

        return answer

    async def _write_all(
        self, responses: AsyncIterator[object], context: Context, share: Share
    ) -> "asyncio.Future[None] | None":
        """Writes responses until one is left unread for `write_s`; returns its writing, None when all are written."""
        async for response in responses:
            share.resize(0)  # what was written before is read, or will be soon
            writing = asyncio.ensure_future(context.write(await encode(response, _serialised, share)))
            if not await _ends(writing, within_s=self._limits.write_s):
                return writing
            if isinstance(writing.exception(), grpc.aio.InternalError):  # the client is gone, or its deadline ended
                raise asyncio.CancelledError
            writing.result()
        return None

    async def _end_unread(self, writing: "asyncio.Future[None]") -> None:
        """Raises DeadlineExceeded once the client reads: no status can be sent before. Does not wait for long."""
        if await _ends(writing, within_s=self._limits.write_s):
            raise DeadlineExceeded(
                f"A reply must be read within {self._limits.write_s:g} s; one was not.",
                hint="Read replies while sending, or open another stream.",
            )
        writing.cancel()
        raise asyncio.CancelledError


class _HealthServicer(health_aio.HealthServicer):
    """The health service of `grpc_health`, and its method `List`, which that leaves out."""

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self._names = names

    async def List(self, _request: Any, context: Context) -> Any:  # noqa: N802  # the RPC's name
        """Returns the status of every service."""
        asked = [health_pb2.HealthCheckRequest(service=name) for name in self._names]
        replies = [await self.Check(request, context) for request in asked]
        response: Any = vars(health_pb2)["HealthListResponse"]  # its stubs leave it out
        return response(statuses=dict(zip(self._names, replies, strict=True)))


def _serialised(response: object) -> bytes:
    return wire.pack(response).SerializeToString()


async def _decode_stream(messages: AsyncIterator[bytes], cls: type[Any]) -> AsyncIterator[Any]:
    """Yields each message as its dataclass, or as an `InvalidMessage`."""
    async for message in messages:
        yield await decode_part(message, cls)


async def _ends(writing: "asyncio.Future[None]", *, within_s: float) -> bool:
    """Returns whether the writing of a message ends in time; cancels it when the call is cancelled."""
    try:
        await asyncio.wait({writing}, timeout=within_s)
    except asyncio.CancelledError:
        writing.cancel()
        raise
    return writing.done()


def _timeout_s(context: Context, longest: float) -> float:
    remaining = context.time_remaining()
    return longest if remaining is None else min(longest, remaining)
