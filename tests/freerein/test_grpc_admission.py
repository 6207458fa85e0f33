"""Which gRPC calls are answered: with the token, how many at once, and how long their first message may take."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import grpc
import pytest

from freerein.api.learning.v1 import learning_pb2
from freerein.errors import DeadlineExceeded, Overloaded
from freerein.serving.grpc_admission import Admission, Receipts
from freerein.serving.grpc_calls import GrpcCalls
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.memory import Memory
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.types.learning import ListModelsResponse

LIST = "/freerein.api.learning.v1.ModelService/ListModels"
CHECK, WATCH = "/grpc.health.v1.Health/Check", "/grpc.health.v1.Health/Watch"
LIMITS = Limits(
    message_bytes=100,
    buffered_bytes=450,
    receipt_s=60.0,
    slow_receipt_s=30.0,
    concurrent_calls=2,
    health_calls=2,
    drain_s=60.0,
)  # two messages may arrive slowly: they have half of the memory
QUICK = replace(LIMITS, receipt_s=1.5, slow_receipt_s=0.1, drain_s=0.5)


class Core:
    """Answers when it is told to."""

    def __init__(self) -> None:
        self.called, self.answer = asyncio.Semaphore(0), asyncio.Event()

    async def list_models(self, _request: Any) -> ListModelsResponse:
        self.called.release()
        await self.answer.wait()
        return ListModelsResponse(())

    async def activate_model(self, _request: Any) -> Any: ...

    async def delete_model(self, _request: Any) -> Any: ...


@asynccontextmanager
async def serving(
    core: Core, health: Health, limits: Limits = LIMITS
) -> AsyncIterator[tuple[GrpcServer, grpc.aio.Channel]]:
    methods = methods_of(learning_pb2.DESCRIPTOR.services_by_name["ModelService"], core)
    server = GrpcServer(methods, health=health, metrics=Metrics(), limits=limits)
    port = server.server.add_insecure_port("127.0.0.1:0")
    await server.server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield server, channel
    await server.server.stop(None)


async def outcome(call: Any) -> str:
    try:
        await call
    except grpc.aio.AioRpcError as error:
        return f"{error.code().name}: {error.details()}"
    return "OK"


async def test_calls_and_health_checks_have_places_of_their_own_and_give_them_back() -> None:
    core, health = Core(), Health()
    async with serving(core, health) as (_server, channel):
        for _ in range(2):
            core.answer.clear()
            calls = [asyncio.create_task(outcome(channel.unary_unary(LIST)(b""))) for _ in range(2)]
            for _ in calls:
                await core.called.acquire()
            assert "At most 2 calls" in await outcome(channel.unary_unary(LIST)(b""))
            watches = [channel.unary_stream(WATCH)(b"") for _ in range(2)]
            for watch in watches:
                await watch.read()
            assert await outcome(channel.unary_unary(CHECK)(b"")) == "OK"  # watches have places of their own
            refused = channel.unary_stream(WATCH)(b"")
            with pytest.raises(grpc.aio.AioRpcError, match="At most 2 health watches"):
                await refused.read()
            for watch in watches:
                watch.cancel()
            core.answer.set()
            assert await asyncio.gather(*calls) == ["OK", "OK"]


async def test_messages_share_the_memory_for_all_until_they_are_answered() -> None:
    core, health = Core(), Health()
    message = b"\xa2\x06\x4d" + bytes(77)  # a field that no message has; three times 80 bytes fit once
    async with serving(core, health) as (_server, channel):
        for _ in range(2):
            core.answer.clear()
            first = asyncio.create_task(outcome(channel.unary_unary(LIST)(message)))
            await core.called.acquire()
            assert "At most 450 bytes" in await outcome(channel.unary_unary(LIST)(message))
            core.answer.set()
            assert await first == "OK"


async def test_a_drain_refuses_new_calls_and_waits_for_those_in_flight() -> None:
    core, health = Core(), Health()
    async with serving(core, health) as (server, channel):
        accepted = asyncio.create_task(outcome(channel.unary_unary(LIST)(b"")))
        await core.called.acquire()
        health.drain()
        draining = asyncio.create_task(server.drain())
        sent_before = asyncio.create_task(outcome(channel.unary_unary(LIST)(b"")))
        await core.called.acquire()
        while not (refused := await outcome(channel.unary_unary(LIST)(b""))).startswith("UNAVAILABLE"):
            assert "At most 2 calls" in refused  # the drain refuses none yet
        assert "The service must be ready" in refused
        assert await outcome(channel.unary_unary(CHECK)(b"")) == "OK"
        assert not draining.done()
        core.answer.set()
        assert await asyncio.gather(accepted, sent_before) == ["OK", "OK"]
        await draining


@pytest.mark.fault("F7")
async def test_callers_that_call_on_are_refused_and_never_cancelled() -> None:
    core, health = Core(), Health()
    core.answer.set()
    async with serving(core, health, replace(LIMITS, concurrent_calls=64)) as (server, channel):
        outcomes: set[str] = set()

        async def call_on() -> None:
            code = ""
            while code != "UNAVAILABLE":
                code = (await outcome(channel.unary_unary(LIST)(b""))).partition(":")[0]
                outcomes.add(code)

        callers = [asyncio.create_task(call_on()) for _ in range(16)]
        await core.called.acquire()
        health.drain()
        await server.drain()
        await asyncio.gather(*callers)
    assert outcomes == {"OK", "UNAVAILABLE"}


async def test_a_drain_does_not_wait_for_calls_that_do_not_end() -> None:
    core, health = Core(), Health()
    async with serving(core, health, QUICK) as (server, channel):
        hanging = asyncio.create_task(outcome(channel.unary_unary(LIST)(b"")))
        await core.called.acquire()
        health.drain()
        await server.drain()
        assert not hanging.done()
        await server.server.stop(None)
        assert (await hanging).startswith(("UNAVAILABLE", "CANCELLED"))


# --- calls of each kind


async def echo(message: bytes, _context: Any) -> bytes:
    return message


async def repeat(message: bytes, _context: Any) -> AsyncIterator[bytes]:
    for _ in range(2):
        yield message


async def write(message: bytes, context: Any) -> None:
    for _ in range(2):
        await context.write(message)


async def join(messages: AsyncIterator[bytes], _context: Any) -> bytes:
    return b"".join([message async for message in messages])


async def chat(messages: AsyncIterator[bytes], _context: Any) -> AsyncIterator[bytes]:
    async for message in messages:
        yield message


HANDLERS = {
    "Echo": grpc.unary_unary_rpc_method_handler(echo),
    "Repeat": grpc.unary_stream_rpc_method_handler(repeat),
    "Write": grpc.unary_stream_rpc_method_handler(write),
    "Join": grpc.stream_unary_rpc_method_handler(join),
    "Chat": grpc.stream_stream_rpc_method_handler(chat),
}


@asynccontextmanager
async def admitted_by(admission: Admission) -> AsyncIterator[grpc.aio.Channel]:
    """A channel to a server of `HANDLERS`."""
    server = grpc.aio.server(interceptors=[admission])
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test", HANDLERS),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield channel
    await server.stop(None)


def admission_with(health: Health, *, token: str = "", **limits: int) -> Admission:
    own = replace(LIMITS, **limits)
    return Admission(health, own, Memory(own), token=token, calls=GrpcCalls((), Metrics()))


async def test_calls_of_each_kind_are_answered_with_all_their_messages() -> None:
    async with admitted_by(admission_with(Health())) as channel:
        assert await channel.unary_unary("/test/Echo")(b"a") == b"a"
        assert [each async for each in channel.unary_stream("/test/Repeat")(b"a")] == [b"a", b"a"]
        assert [each async for each in channel.unary_stream("/test/Write")(b"a")] == [b"a", b"a"]
        assert await channel.stream_unary("/test/Join")([b"a", b"b", b"c"]) == b"abc"
        assert [each async for each in channel.stream_stream("/test/Chat")([b"a", b"b"])] == [b"a", b"b"]


async def test_a_call_without_a_message_or_of_an_unknown_method_is_told_so() -> None:
    async with admitted_by(admission_with(Health())) as channel:
        for _ in range(3):  # more than there are places
            assert "INVALID_ARGUMENT: A call must send a message" in await outcome(
                channel.stream_unary("/test/Echo")([])
            )
            assert "UNIMPLEMENTED" in await outcome(channel.unary_unary("/test/Nothing")(b""))


async def test_calls_need_the_token() -> None:
    async with admitted_by(admission_with(Health(), token="secret")) as channel:
        right, wrong = [("authorization", "Bearer secret")], [("authorization", "Bearer secrets")]
        assert await outcome(channel.unary_unary("/test/Echo")(b"", metadata=right)) == "OK"
        for metadata in (wrong, [], None):
            assert "UNAUTHENTICATED" in await outcome(channel.unary_unary("/test/Echo")(b"", metadata=metadata))


async def test_streams_have_a_limit_of_their_own_and_give_their_places_back() -> None:
    admission = admission_with(Health(), streams=1)
    async with admitted_by(admission) as channel:
        for _ in range(2):
            stream = channel.stream_stream("/test/Chat")()
            await stream.write(b"a")
            assert await stream.read() == b"a"
            assert admission.in_progress == 1
            with pytest.raises(grpc.aio.AioRpcError, match="At most 1 streams may be open"):
                await channel.unary_stream("/test/Repeat")(b"").read()
            assert await outcome(channel.unary_unary("/test/Echo")(b"")) == "OK"
            await stream.done_writing()
            assert await stream.read() is grpc.aio.EOF
    assert admission.in_progress == 0


async def test_a_drain_admits_calls_until_it_refuses_them() -> None:
    health = Health()
    admission = admission_with(health)
    async with admitted_by(admission) as channel:
        await channel.unary_unary("/test/Echo")(b"")
        health.drain()
        await channel.unary_unary("/test/Echo")(b"")  # may have been sent before
        admission.refuse()
        assert admission.admitted == 2
        for _ in range(2):
            assert "UNAVAILABLE" in await outcome(channel.unary_unary("/test/Echo")(b""))
        assert admission.admitted == 2


# --- how long a message may take


@pytest.fixture
def receive() -> Callable[[], "asyncio.Task[str]"]:
    """A function that begins to receive a message that never comes."""
    receipts = Receipts(QUICK, Memory(QUICK))

    async def never() -> str:
        try:
            return await receipts.receive(asyncio.get_running_loop().create_future())
        except DeadlineExceeded as error:
            return f"late: {error.detail}"
        except Overloaded as error:
            return f"overloaded: {error.detail}"

    return lambda: asyncio.create_task(never())


async def test_a_message_may_take_until_its_deadline_and_few_may_take_long(
    receive: Callable[[], "asyncio.Task[str]"],
) -> None:
    for _ in range(2):  # whoever is refused or late gives its place back
        begun = asyncio.get_running_loop().time()
        tasks = [receive() for _ in range(3)]
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        took_s = asyncio.get_running_loop().time() - begun
        overloaded = "overloaded: At most 2 messages may arrive slowly at once; the limit is reached."
        assert overloaded in {each.result() for each in done}
        assert took_s >= QUICK.slow_receipt_s
        assert len(done) == 1 or took_s >= QUICK.receipt_s  # where a busy machine lets all deadlines pass at once
        late = "late: A message must arrive within 1.5 s; this one did not."
        assert sorted(await asyncio.gather(*tasks))[:2] == [late, late]
        assert asyncio.get_running_loop().time() - begun >= QUICK.receipt_s


async def test_a_message_that_comes_late_but_in_time_is_received() -> None:
    receipts = Receipts(replace(QUICK, receipt_s=60.0), Memory(QUICK))
    loop = asyncio.get_running_loop()
    for _ in range(3):  # more than may arrive slowly at once
        message = loop.create_future()
        loop.call_later(2 * QUICK.slow_receipt_s, message.set_result, b"x")
        assert await receipts.receive(message) == b"x"


async def test_messages_that_come_at_once_neither_take_a_place_nor_give_one_back() -> None:
    receipts = Receipts(replace(QUICK, receipt_s=60.0), Memory(QUICK))
    loop = asyncio.get_running_loop()

    async def receive(after_s: float) -> str:
        message = loop.create_future()
        loop.call_later(after_s, message.set_result, "received")
        try:
            return str(await receipts.receive(message))
        except Overloaded:
            return "overloaded"

    assert [await receive(0) for _ in range(3)] == ["received"] * 3
    slow = [receive(3 * QUICK.slow_receipt_s) for _ in range(3)]
    assert sorted(await asyncio.gather(*slow)) == ["overloaded", "received", "received"]
