"""What robots may say wrongly, too much or too fast on a control stream, to a real service over a socket."""

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import numpy as np
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein import wire
from freerein.api.common.v1 import common_pb2
from freerein.api.imitation.v1 import imitation_pb2
from freerein.clients import Channel, ImitationClient
from freerein.serving.limits import Limits

pytestmark = pytest.mark.e2e
CONTROL = "/freerein.api.imitation.v1.ImitationService/Control"
OPTIONS = (("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1))
LIMIT = Limits().message_bytes
MIB = 2**20


@pytest.fixture(scope="module")
def faulty(start_faulty: Callable[..., Any]) -> Any:
    return start_faulty(module="tests.faults.faulty_policy")


@pytest.fixture
async def client(faulty: Any) -> AsyncIterator[ImitationClient]:
    async with ImitationClient(Channel(faulty.service.address)) as client:
        yield client


@pytest.fixture
async def raw(faulty: Any) -> AsyncIterator[Any]:
    """A stream of bytes, that has said Hello."""
    async with grpc.aio.insecure_channel(faulty.service.address, OPTIONS) as channel:
        call = channel.stream_stream(CONTROL)(timeout=300)
        await call.write(wire.pack(robots.hello()).SerializeToString())
        assert imitation_pb2.ControlResponse.FromString(await call.read()).HasField("spec")
        yield call
        call.cancel()


async def ask(call: Any, message: bytes) -> Any:
    await call.write(message)
    return imitation_pb2.ControlResponse.FromString(await call.read())


def seen(seq: int) -> Any:
    return wire.pack(robots.seen(seq))


IMAGE = common_pb2.Image(encoding=1, height=4, width=4, data=bytes(48))
NAN = np.full(2, np.nan, "<f4").tobytes()


@pytest.mark.fault("I1")
async def test_a_bad_observation_is_refused_by_name_and_the_stream_goes_on(raw: Any) -> None:
    """What only a message can say wrongly; `imitation/test_core_act.py` has the rest."""
    bad = [
        (common_pb2.Image(data=bytes(48)), None, "observed.observation.images.0.encoding"),
        (common_pb2.Image(encoding=99, data=bytes(48)), None, "observed.observation.images.0.encoding"),
        (common_pb2.Image(encoding=1, height=4, width=5, data=bytes(60)), None, "observation.images.0"),
        (common_pb2.Image(encoding=1, data=bytes(48), camera="x" * MIB), None, "observed.observation.im"),
        (IMAGE, common_pb2.Tensor(datatype="FP64", shape=[1, 2], raw=bytes(16)), "executed_actions"),
        (IMAGE, common_pb2.Tensor(datatype="FP32", shape=[1, 2], raw=NAN), "executed_actions"),
    ]
    for number, (image, executed, field) in enumerate(bad):
        observation = common_pb2.Observation(images=[image])
        observed = imitation_pb2.Observed(seq=2 * number, observation=observation, executed_actions=executed)
        reply = await ask(raw, imitation_pb2.ControlRequest(observed=observed).SerializeToString())
        assert reply.seq == 2 * number
        assert reply.error.field.startswith(field)
        assert reply.error.hint
        assert len(reply.error.detail) < 1000
        assert (await ask(raw, seen(2 * number + 1).SerializeToString())).HasField("chunk")


LIES: list[tuple[list[int], bytes]] = [
    ([2**31, 2], b"\0"),
    ([2**62, 2**62], b""),
    ([2**63 - 1], b"\0" * 8),
    ([-1, 2], bytes(8)),
    ([1, 2], bytes(7)),
    ([1, 2], bytes(9)),
    ([0, 2], bytes(8)),
    ([1] * 1000, bytes(4)),
    ([], bytes(4)),
]


@pytest.mark.fault("I2")
@pytest.mark.parametrize("datatype", ["FP32", "INT64", "FP16", "float32", ""])
async def test_a_tensor_that_lies_is_refused_and_the_stream_goes_on(raw: Any, datatype: str) -> None:
    for number, (shape, bytes_) in enumerate(LIES):
        message = seen(2 * number)
        message.observed.executed_actions.CopyFrom(common_pb2.Tensor(datatype=datatype, shape=shape, raw=bytes_))
        reply = await ask(raw, message.SerializeToString())
        assert (reply.seq, reply.error.code) == (2 * number, "invalid_input"), shape
        assert "executed_actions" in reply.error.field
        assert (await ask(raw, seen(2 * number + 1).SerializeToString())).HasField("chunk")


@pytest.mark.fault("I3")
async def test_a_message_of_just_the_limit_is_read_and_one_byte_more_ends_the_stream(raw: Any) -> None:
    message = seen(3).SerializeToString()
    size = LIMIT - len(message) - 6  # an unknown field, ignored: 2 bytes of tag, 4 of length
    message += b"\xf2\x3f" + bytes([size & 127 | 128, size >> 7 & 127 | 128, size >> 14 & 127 | 128, size >> 21])
    message += bytes(size)
    assert len(message) == LIMIT
    assert (await ask(raw, message)).HasField("chunk")
    with pytest.raises((grpc.aio.AioRpcError, asyncio.InvalidStateError)):
        await ask(raw, message + b"\0")
    assert await raw.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


@pytest.mark.fault("I5")
async def test_a_flood_takes_no_memory_and_what_is_overtaken_is_counted(raw: Any, faulty: Any) -> None:
    padding = b"\xf2\x3f\x80\x80\x08" + bytes(2**17)  # an unknown field of 128 KiB

    before, peak = faulty.process.memory_info().rss, 0
    await raw.write(wire.pack(robots.seen(0, fault="held")).SerializeToString())
    with await asyncio.to_thread(faulty.hold):
        for seq in range(1, 2_000):
            await raw.write(seen(seq).SerializeToString() + padding)
            peak = max(peak, faulty.process.memory_info().rss)
    await raw.done_writing()
    seqs, reply = [], None
    while (received := await raw.read()) is not grpc.aio.EOF:
        reply = imitation_pb2.ControlResponse.FromString(received)
        seqs.append(reply.seq)
    assert reply is not None
    assert seqs == sorted(set(seqs))
    assert seqs[-1] == 1_999
    assert len(seqs) + reply.chunk.dropped == 2_000
    assert reply.chunk.dropped > 0
    assert peak - before < 64 * MIB


@pytest.mark.fault("I13")
async def test_one_who_leaves_while_in_a_batch_disturbs_nobody_and_is_let_go(
    client: ImitationClient, faulty: Any, wait_until: Any
) -> None:
    policy = policies.FaultyPolicy(policies.SEEDS[0])
    streams = [robots.Stream(client.control) for _ in range(6)]
    oracles = [await robots.Oracle.of(policy, 50 + i) for i in range(6)]
    await asyncio.gather(*(stream.ask(robots.hello(50 + i)) for i, stream in enumerate(streams)))
    for seq in range(5):
        requests = [robots.seen(seq, 10 * seq + i, hundredths=5) for i in range(6)]
        for stream, request in zip(streams, requests, strict=True):
            stream.say(request)
        if seq == 2:
            leaver = robots.Stream(client.control)
            await leaver.ask(robots.hello())
            leaver.say(robots.seen(0, hundredths=5))
            await leaver.leave()
        for stream, oracle, request in zip(streams, oracles, requests, strict=True):
            await oracle.check(request, await stream.hear())
    assert [await stream.rest() for stream in streams] == [[]] * 6
    await asyncio.to_thread(wait_until, lambda: faulty.metric('freerein_calls_in_flight{protocol="grpc"}') == 0, 60)
    assert faulty.metric("freerein_queued_items") == 0


@pytest.mark.fault("I14")
@pytest.mark.parametrize(("fault", "code"), [("shape", "model_fault"), ("nan", "output_not_finite")])
async def test_a_poisonous_observation_fails_alone(client: ImitationClient, fault: str, code: str) -> None:
    policy = policies.FaultyPolicy(policies.SEEDS[0])
    streams = [robots.Stream(client.control) for _ in range(8)]
    oracles = [await robots.Oracle.of(policy, 50 + i) for i in range(8)]
    await asyncio.gather(*(stream.ask(robots.hello(50 + i)) for i, stream in enumerate(streams)))
    for seq in range(4):
        requests = [
            robots.seen(seq, i, hundredths=2, fault=fault if i == 3 and seq == 2 else "right") for i in range(8)
        ]
        for stream, request in zip(streams, requests, strict=True):
            stream.say(request)
        for i, (stream, oracle) in enumerate(zip(streams, oracles, strict=True)):
            reply = await stream.hear()
            if i == 3 and seq == 2:
                assert (reply.seq, reply.error.code) == (seq, code)
            else:
                await oracle.check(requests[i], reply)
    assert [await stream.rest() for stream in streams] == [[]] * 8
