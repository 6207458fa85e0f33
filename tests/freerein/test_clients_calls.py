"""What every call of every client does, against a peer that speaks gRPC and nothing of ours."""
# ruff: noqa: N802 -- gRPC names the methods

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest
from google.protobuf.duration_pb2 import Duration
from google.rpc import error_details_pb2, status_pb2
from grpc import aio
from grpc_status import rpc_status

from freerein import errors, wire
from freerein.api.learning.v1 import learning_pb2, learning_pb2_grpc
from freerein.api.segmentation.v1 import segmentation_pb2_grpc
from freerein.api.sim.v1 import sim_pb2_grpc
from freerein.clients import Channel, FitClient, ModelClient, SegmentationClient, SimClient, retry_policy
from freerein.clients.channel import MAX_MESSAGE_BYTES
from freerein.clients.request_slices import request_slices
from freerein.types import learning, segmentation, sim
from freerein.types.common import Image, ModelRef, Timing, Trajectory

SESSION = "0" * 32
LAST_STEP = 99
SKILLS = segmentation.ListSkillsRequest()
TASK = sim.Task("push", "table", "", (), sim.ActionSpec(2, 0, ("x", "y")), 0.1, (), 50)
FIT = learning.Fit(SESSION, "queued", {}, dataset="demos", model_name="default")


@dataclass
class Peer(
    segmentation_pb2_grpc.SegmentationServiceServicer,
    sim_pb2_grpc.SimServiceServicer,
    learning_pb2_grpc.FitServiceServicer,
    learning_pb2_grpc.ModelServiceServicer,
):
    """Refuses calls with the statuses of `refusals`, first to last; then answers. Remembers what it was sent."""

    refusals: list[grpc.Status] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    metadata: list[dict[str, str | bytes]] = field(default_factory=list)
    time_remaining_s: list[float] = field(default_factory=list)
    requests: list[object] = field(default_factory=list)

    async def receive(self, request, context) -> None:
        self.calls.append(type(request).__name__.removesuffix("Request"))
        self.requests.append(request)
        self.metadata.append(dict(context.invocation_metadata()))
        self.time_remaining_s.append(context.time_remaining())
        if self.refusals:
            await context.abort_with_status(self.refusals.pop(0))

    async def ListSkills(self, request, context):
        await self.receive(request, context)
        return wire.pack(segmentation.ListSkillsResponse(("move", "turn"), ModelRef(), 2, 2, 3, 0, 0))

    async def Segment(self, request, context):
        await self.receive(request, context)
        labels, confidence = np.zeros(1, np.int64), np.ones(1, np.float32)
        return wire.pack(
            segmentation.SegmentResponse(labels, confidence, confidence, (), ("move",), ModelRef(), Timing())
        )

    async def SegmentStream(self, request_iterator, context):
        async for request in request_iterator:
            timesteps = wire.unpack(request, segmentation.SegmentStreamRequest).timesteps
            if timesteps is None:
                skills = segmentation.ListSkillsResponse(("move",), ModelRef(), 1, 1, 1, 0, 0)
                yield wire.pack(segmentation.SegmentStreamResponse(opened=segmentation.SegmentStreamOpened(skills, 0)))
                continue
            labels, confidence = (np.zeros(len(timesteps.frames), kind) for kind in (np.int64, np.float32))
            final = segmentation.StreamLabels(0, labels, confidence, confidence, (), labels[:0], Timing())
            yield wire.pack(segmentation.SegmentStreamResponse(timesteps.seq, labels=final))
            self.calls.append(f"{len(timesteps.frames)} timesteps")

    async def CreateSession(self, request, context):
        await self.receive(request, context)
        return wire.pack(sim.CreateSessionResponse(SESSION, 0, 1, TASK, 60.0))

    async def Reset(self, request, context):
        await self.receive(request, context)
        return wire.pack(sim.ResetResponse({"front": np.zeros((1, 2048, 2048, 3), np.uint8)}))

    async def Render(self, request, context):
        await self.receive(request, context)
        await asyncio.Event().wait()

    async def Snapshot(self, request, context):
        await self.receive(request, context)
        return wire.pack(sim.SnapshotResponse(bytes(MAX_MESSAGE_BYTES)))

    async def Connect(self, request_iterator, context):
        async for request in request_iterator:
            if request.step.step_id == LAST_STEP:
                return
            if self.refusals:
                await context.abort_with_status(self.refusals.pop(0))
            no = np.zeros(1, np.bool_)
            step = sim.StepResponse(request.step.step_id, {}, np.zeros(1, np.float32), no, no, no, {})
            yield wire.pack(sim.ConnectResponse(step=step))

    async def Demonstrate(self, request, context):
        await self.receive(request, context)
        trajectory = Trajectory({"front": np.zeros((2, 4, 4, 3), np.uint8)}, np.zeros((2, 3), np.float32), ("move",))
        for index in range(request.count):
            yield wire.pack(sim.DemonstrateResponse(index, trajectory))
        if request.seed:
            await context.abort(grpc.StatusCode.ABORTED, "the worker is gone")
        await asyncio.Event().wait()

    async def StartFit(self, request, context):
        await self.receive(request, context)
        return wire.pack(learning.StartFitResponse(replace(FIT, config=dict(request.config))))

    async def GetFit(self, request, context):
        return learning_pb2.GetFitResponse(fit=learning_pb2.Fit(state=17))

    async def WatchFit(self, request, context):
        await self.receive(request, context)
        for sequence in range(request.from_sequence, 3):
            yield wire.pack(learning.WatchFitResponse(sequence, FIT))

    async def ActivateModel(self, request, context):
        await self.receive(request, context)


def refusal(reason: str, code: grpc.StatusCode, *, retry_after_s: float = 0.0) -> grpc.Status:
    status = status_pb2.Status(code=code.value[0], message="Expected one thing; got another.")
    metadata = {"field": "actions", "hint": "Send the one thing.", "request_id": "x"}
    status.details.add().Pack(error_details_pb2.ErrorInfo(reason=reason, domain="freerein", metadata=metadata))
    if retry_after_s:
        delay = Duration()
        delay.FromMilliseconds(int(retry_after_s * 1e3))
        status.details.add().Pack(error_details_pb2.RetryInfo(retry_delay=delay))
    return rpc_status.to_status(status)


UNAVAILABLE = refusal("unavailable", grpc.StatusCode.UNAVAILABLE)


@asynccontextmanager
async def serving(
    peer: Peer, *, credentials: grpc.ServerCredentials | None = None, port: int = 0
) -> AsyncIterator[str]:
    server = aio.server(options=[("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)])
    segmentation_pb2_grpc.add_SegmentationServiceServicer_to_server(peer, server)
    sim_pb2_grpc.add_SimServiceServicer_to_server(peer, server)
    learning_pb2_grpc.add_FitServiceServicer_to_server(peer, server)
    learning_pb2_grpc.add_ModelServiceServicer_to_server(peer, server)
    if credentials is None:
        address = f"127.0.0.1:{server.add_insecure_port(f'127.0.0.1:{port}')}"
    else:
        address = f"localhost:{server.add_secure_port(f'localhost:{port}', credentials)}"
    await server.start()
    try:
        yield address
    finally:
        await server.stop(None)


@pytest.fixture
async def peer() -> Peer:
    return Peer()


@pytest.fixture
async def channel(peer: Peer) -> AsyncIterator[Channel]:
    async with serving(peer) as address:
        channel = Channel(address, token="secret")
        yield channel
        await channel.close()


# --- what goes with a call


async def test_a_call_carries_a_deadline_a_token_and_a_request_id_of_its_own(channel: Channel, peer: Peer) -> None:
    client = SegmentationClient(channel)
    assert (await client.list_skills(SKILLS)).skills == ("move", "turn")
    await client.list_skills(SKILLS, timeout_s=100.0)
    assert 15.0 < peer.time_remaining_s[0] < 31.0
    assert 31.0 < peer.time_remaining_s[1] < 101.0
    assert peer.metadata[0]["authorization"] == "Bearer secret"
    ids = [str(metadata["x-request-id"]) for metadata in peer.metadata]
    assert all(re.fullmatch("[0-9a-f]{32}", request_id) for request_id in ids)
    assert ids[0] != ids[1]


async def test_without_a_token_none_is_sent(peer: Peer) -> None:
    async with serving(peer) as address, SegmentationClient(Channel(address)) as client:
        await client.list_skills(SKILLS)
    assert "authorization" not in peer.metadata[0]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
async def test_a_service_on_this_machine_is_called_without_the_environments_proxy(
    peer: Peer, monkeypatch: pytest.MonkeyPatch, host: str
) -> None:
    for name in ("no_proxy", "no_grpc_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    async with (
        serving(peer) as address,
        SegmentationClient(Channel(address.replace("127.0.0.1", host))) as client,
    ):
        await client.list_skills(SKILLS)


async def test_a_call_that_gets_no_answer_ends_at_its_deadline(channel: Channel) -> None:
    with pytest.raises(errors.DeadlineExceeded, match=r"Render at 127\.0\.0\.1:\d+ failed"):
        await SimClient(channel).render(sim.RenderRequest(SESSION), timeout_s=0.2)


@pytest.mark.parametrize("timeout_s", [0, -1.0, float("nan"), float("-inf"), True, "30"])
async def test_a_timeout_that_is_none_is_refused_by_its_name(channel: Channel, peer: Peer, timeout_s: Any) -> None:
    client = SimClient(channel)
    calls = [
        client.render(sim.RenderRequest(SESSION), timeout_s=timeout_s),
        SegmentationClient(channel).list_skills(SKILLS, timeout_s=timeout_s),
        anext(client.demonstrate(sim.DemonstrateRequest("push", "expert", count=1), timeout_s=timeout_s)),
        anext(client.connect(no_requests(), timeout_s=timeout_s)),
    ]
    for call in calls:
        with pytest.raises(errors.InvalidInput, match="`timeout_s` must be seconds above 0") as error:
            await call
        assert error.value.field == "timeout_s"
    assert not peer.calls


def test_a_time_of_silence_is_at_least_a_second() -> None:
    Channel("127.0.0.1:9104", keepalive_s=float("inf"))
    for keepalive_s in (0.5, float("nan"), -1):
        with pytest.raises(errors.InvalidInput, match="`keepalive_s` must be at least 1 second"):
            Channel("127.0.0.1:9104", keepalive_s=keepalive_s)


async def no_requests() -> AsyncIterator[sim.ConnectRequest]:
    return
    yield


@pytest.mark.parametrize("timeout_s", [float("inf"), 1e12, 1e300, None, np.float32(9), 9])
async def test_a_timeout_may_be_endless_and_of_any_type_of_number(channel: Channel, timeout_s: Any) -> None:
    assert (await SegmentationClient(channel).list_skills(SKILLS, timeout_s=timeout_s)).skills == ("move", "turn")


def test_a_client_of_another_event_loop_says_so(reserve_ports: Any) -> None:
    port = reserve_ports(["sim"])["sim"].grpc
    client = SimClient(Channel(f"127.0.0.1:{port}"))

    async def call() -> None:
        await client.list_tasks(sim.ListTasksRequest(), timeout_s=5.0)

    async def iterate() -> None:
        await anext(client.demonstrate(sim.DemonstrateRequest("push", "expert", count=1)))

    with pytest.raises(errors.Unavailable):
        asyncio.run(call())
    for again in (call, iterate):
        with pytest.raises(errors.FailedPrecondition, match="event loop of its first call") as error:
            asyncio.run(again())
        assert "SyncClient" in error.value.hint
    asyncio.run(client.close())


async def test_the_proxy_of_the_environment_is_named_where_a_call_took_it(
    monkeypatch: pytest.MonkeyPatch, reserve_ports: Any
) -> None:
    for name in ("grpc_proxy", "https_proxy", "no_proxy", "no_grpc_proxy"):
        monkeypatch.delenv(name, raising=False)
    port = reserve_ports(["sim"])["sim"].grpc
    monkeypatch.setenv("http_proxy", f"http://secret@127.0.0.1:{port}")
    async with SimClient(Channel("sim.invalid:9104")) as client:
        with pytest.raises(errors.ServiceError) as error:
            await client.render(sim.RenderRequest(SESSION), timeout_s=1.0)
        assert "the proxy in `http_proxy`" in error.value.hint
        assert "secret" not in f"{error.value.detail} {error.value.hint}"
    monkeypatch.setenv("no_proxy", "localhost, .invalid")
    assert Channel("sim.invalid:9104").proxy == Channel("127.0.0.1:9104").proxy == ""
    monkeypatch.setenv("grpc_proxy", "http://127.0.0.1:9")
    assert Channel("sim.example:9104").proxy == "grpc_proxy"


async def test_an_idempotency_key_is_made_where_the_caller_gave_none(channel: Channel, peer: Peer) -> None:
    await SimClient(channel).create_session(sim.CreateSessionRequest("push"))
    await SimClient(channel).create_session(sim.CreateSessionRequest("push", idempotency_key="mine"))
    reply = await FitClient(channel).start_fit(learning.StartFitRequest("demos", config={"steps": 5}))
    keys = [request.idempotency_key for request in peer.requests]
    assert len(keys[0]) == len(keys[2]) == 32
    assert keys[1] == "mine"
    assert reply.fit.config == {"steps": 5}


# --- errors


@pytest.mark.parametrize("cls", [errors.OutputNotFinite, errors.WorkerLost, errors.Unauthenticated])
async def test_an_error_of_a_service_is_raised_as_the_class_that_it_was(
    channel: Channel, peer: Peer, cls: type[errors.ServiceError]
) -> None:
    peer.refusals = [refusal(cls.code, grpc.StatusCode[cls.grpc_status])]
    with pytest.raises(errors.ServiceError) as caught:
        await SegmentationClient(channel).list_skills(SKILLS)
    assert type(caught.value) is cls
    assert caught.value.detail == "Expected one thing; got another."
    assert caught.value.field == "actions"
    assert caught.value.hint == "Send the one thing."
    assert caught.value.retry_after_s is None
    request_id = peer.metadata[0]["x-request-id"]
    assert caught.value.__notes__ == ["Hint: Send the one thing.", f"Request id: {request_id!s}"]


async def test_an_error_says_when_to_try_again(channel: Channel, peer: Peer) -> None:
    peer.refusals = [refusal("overloaded", grpc.StatusCode.RESOURCE_EXHAUSTED, retry_after_s=2.5)]
    with pytest.raises(errors.Overloaded) as caught:
        await SegmentationClient(channel).list_skills(SKILLS)
    assert caught.value.retry_after_s == 2.5


async def test_a_reason_of_a_later_version_is_internal(channel: Channel, peer: Peer) -> None:
    peer.refusals = [refusal("out_of_luck", grpc.StatusCode.ABORTED)]
    with pytest.raises(errors.Internal, match="Expected one thing"):
        await SegmentationClient(channel).list_skills(SKILLS)


async def test_a_status_with_unreadable_details_counts_by_its_code(channel: Channel, peer: Peer) -> None:
    status = rpc_status.to_status(status_pb2.Status(code=grpc.StatusCode.NOT_FOUND.value[0], message="gone"))
    peer.refusals = [status._replace(trailing_metadata=(("grpc-status-details-bin", b"\xff\xff\xff"),))]
    with pytest.raises(errors.NotFound, match=r"ListSkills at .* failed: gone"):
        await SegmentationClient(channel).list_skills(SKILLS)


async def test_nobody_listening_is_unavailable_and_the_address_is_named(reserve_ports: Any) -> None:
    port = reserve_ports(["sim"])["sim"].grpc
    async with SimClient(Channel(f"127.0.0.1:{port}")) as client:
        with pytest.raises(errors.Unavailable, match=f"Reset at 127.0.0.1:{port}") as caught:
            await client.reset(sim.ResetRequest(SESSION))
    assert caught.value.hint


async def test_a_call_that_the_service_does_not_have_is_unimplemented(channel: Channel) -> None:
    with pytest.raises(errors.Unimplemented):
        await SimClient(channel).list_tasks(sim.ListTasksRequest())


async def test_a_reply_that_cannot_be_read_is_not_blamed_on_the_request(channel: Channel) -> None:
    with pytest.raises(errors.Internal, match="reply cannot be read"):
        await FitClient(channel).get_fit(learning.GetFitRequest(SESSION))


# --- retries


async def test_an_idempotent_call_is_tried_again_under_one_request_id(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE] * 2
    await SegmentationClient(channel).list_skills(SKILLS)
    assert peer.calls == ["ListSkills"] * 3
    assert len({metadata["x-request-id"] for metadata in peer.metadata}) == 1


async def test_all_attempts_share_one_deadline(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE]
    with pytest.raises(errors.DeadlineExceeded):
        await SimClient(channel).render(sim.RenderRequest(SESSION), timeout_s=10)
    assert peer.calls == ["Render"] * 2


@pytest.mark.fault("N5")
async def test_a_call_is_tried_four_times_and_no_more(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE] * 9
    with pytest.raises(errors.Unavailable):
        await SegmentationClient(channel).list_skills(SKILLS)
    assert len(peer.calls) == retry_policy.MAX_ATTEMPTS == 4


@pytest.mark.fault("N5")
async def test_an_outage_is_not_answered_with_a_storm(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE] * 10_000
    client = SegmentationClient(channel)
    for _ in range(2):
        calls = [client.list_skills(SKILLS) for _ in range(500)]
        failed = await asyncio.gather(*calls, return_exceptions=True)
        assert all(isinstance(error, errors.Unavailable) for error in failed)
    assert len(peer.calls) <= 1.1 * 1_000


async def test_a_call_that_is_not_idempotent_is_tried_once(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE] * 2
    with pytest.raises(errors.Unavailable):
        await SimClient(channel).reset(sim.ResetRequest(SESSION))
    with pytest.raises(errors.Unavailable):
        await ModelClient(channel).activate_model(learning.ActivateModelRequest("default", "a"))
    assert peer.calls == ["Reset", "ActivateModel"]


@pytest.mark.fault("N5")
@pytest.mark.parametrize("code", ["overloaded", "internal", "worker_lost"])
async def test_only_unavailable_is_tried_again(channel: Channel, peer: Peer, code: str) -> None:
    peer.refusals = [refusal(code, grpc.StatusCode[errors.by_code(code).grpc_status])]
    with pytest.raises(errors.ServiceError):
        await SegmentationClient(channel).list_skills(SKILLS)
    assert len(peer.calls) == 1


async def test_a_large_request_is_tried_again_too(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE]
    frames = np.zeros((1, 1024, 1024, 3), np.uint8)
    await SegmentationClient(channel).segment(segmentation.SegmentRequest(frames=frames))
    assert peer.calls == ["Segment"] * 2


# --- limits


async def test_messages_of_many_megabytes_pass(channel: Channel) -> None:
    assert (await SimClient(channel).reset(sim.ResetRequest(SESSION))).frames["front"].nbytes == 12 * 2**20


async def test_a_request_over_the_limit_is_refused_before_it_is_sent(channel: Channel, peer: Peer) -> None:
    request = segmentation.SegmentRequest(video=bytes(MAX_MESSAGE_BYTES))
    with pytest.raises(errors.TooLarge, match="at most 67108864 bytes; got 671088"):
        await SegmentationClient(channel).segment(request)
    assert peer.calls == []


def test_many_images_are_sliced_by_number_bytes_and_pixels() -> None:
    small, photo = (Image("raw_rgb8", *size, b"") for size in ((4, 4), (4_000, 3_000)))
    heavy = Image("raw_rgb8", 4, 4, bytes(MAX_MESSAGE_BYTES // 2))
    assert list(request_slices([[small]] * 40)) == [slice(0, 16), slice(16, 32), slice(32, 40)]
    assert list(request_slices([[photo]] * 7)) == [slice(0, 5), slice(5, 7)]
    assert list(request_slices([[photo, photo]] * 3)) == [slice(0, 2), slice(2, 3)]
    assert list(request_slices([[heavy]] * 2)) == [slice(0, 1), slice(1, 2)]
    assert list(request_slices([])) == []


async def test_a_trajectory_of_more_timesteps_than_a_request_may_have_is_sent_as_a_stream(
    channel: Channel, peer: Peer
) -> None:
    frames = np.zeros((20_001, 1, 1, 1), np.uint8)
    answer = await SegmentationClient(channel).segment(segmentation.SegmentRequest(frames=frames), timeout_s=60)
    assert len(answer.labels) == 20_001
    assert peer.calls == ["20000 timesteps", "1 timesteps"]


async def test_a_reply_over_the_limit_is_too_large_and_not_overload(channel: Channel) -> None:
    with pytest.raises(errors.TooLarge, match="Snapshot at"):
        await SimClient(channel).snapshot(sim.SnapshotRequest(SESSION))


# --- streams


async def test_a_stream_is_an_iterator_without_a_deadline(channel: Channel, peer: Peer) -> None:
    events = [event async for event in FitClient(channel).watch_fit(learning.WatchFitRequest(SESSION, 1))]
    assert [event.sequence for event in events] == [1, 2]
    assert events[0].fit.state == "queued"
    assert peer.time_remaining_s[0] is None or peer.time_remaining_s[0] > 1e6


async def test_a_stream_begins_again_only_before_its_first_message(channel: Channel, peer: Peer) -> None:
    peer.refusals = [UNAVAILABLE]
    events = [event async for event in FitClient(channel).watch_fit(learning.WatchFitRequest(SESSION))]
    assert [event.sequence for event in events] == [0, 1, 2]
    assert peer.calls == ["WatchFit"] * 2


async def test_a_stream_that_breaks_gives_what_came_and_then_raises(channel: Channel) -> None:
    demonstrations = SimClient(channel).demonstrate(sim.DemonstrateRequest("push", "expert", count=2, seed=1))
    assert [(await anext(demonstrations)).index for _ in range(2)] == [0, 1]
    with pytest.raises(errors.ServiceError, match=r"Demonstrate at .* the worker is gone"):
        await anext(demonstrations)


async def test_a_stream_ends_at_the_deadline_of_its_caller(channel: Channel) -> None:
    demonstrations = SimClient(channel).demonstrate(sim.DemonstrateRequest("push", "random"), timeout_s=10)
    assert (await anext(demonstrations)).trajectory.skills == ("move",)
    with pytest.raises(errors.DeadlineExceeded):
        await anext(demonstrations)


async def test_an_iterator_that_nobody_iterates_makes_no_call(channel: Channel, peer: Peer) -> None:
    client = SimClient(channel)
    await client.demonstrate(sim.DemonstrateRequest("push", "random")).aclose()
    await SegmentationClient(channel).list_skills(SKILLS)
    assert peer.calls == ["ListSkills"]


async def test_a_stepping_stream_answers_message_by_message(channel: Channel) -> None:
    answered = asyncio.Event()

    async def requests() -> AsyncIterator[sim.ConnectRequest]:
        yield sim.ConnectRequest(step=sim.StepRequest(SESSION, 1, np.zeros((1, 2), np.float32)))
        await answered.wait()
        yield sim.ConnectRequest(step=sim.StepRequest(SESSION, 2, np.zeros((1, 2), np.float32)))

    step_ids = []
    async for reply in SimClient(channel).connect(requests()):
        assert reply.step is not None
        step_ids.append(reply.step.step_id)
        answered.set()
    assert step_ids == [1, 2]


@pytest.mark.parametrize("answered", [0, 1])
async def test_what_the_iterator_of_requests_raises_is_raised(channel: Channel, answered: int) -> None:
    async def requests() -> AsyncIterator[sim.ConnectRequest]:
        for step in range(answered):
            yield sim.ConnectRequest(step=sim.StepRequest(SESSION, step, np.zeros((1, 2), np.float32)))
        raise OSError("the camera is gone")

    with pytest.raises(OSError, match="the camera is gone"):
        [reply async for reply in SimClient(channel).connect(requests())]


@pytest.mark.parametrize("refused", [True, False])
async def test_a_stream_that_ends_while_requests_are_sent_ends_as_the_service_said(
    channel: Channel, peer: Peer, *, refused: bool
) -> None:
    step = sim.StepRequest(SESSION, 0 if refused else LAST_STEP, np.zeros((1, 2), np.float32))

    async def requests() -> AsyncIterator[sim.ConnectRequest]:
        for _ in range(20):
            yield sim.ConnectRequest(step=step)
            await asyncio.sleep(0)

    client = SimClient(channel)
    for _ in range(20):  # of writes, most fail after the end of the stream
        peer.refusals = [refusal("invalid_input", grpc.StatusCode.INVALID_ARGUMENT)] * refused
        with pytest.raises(errors.InvalidInput) if refused else nullcontext():
            assert [reply async for reply in client.connect(requests())] == []


async def test_of_a_stream_that_the_service_ended_no_more_requests_are_taken(channel: Channel) -> None:
    waiting = asyncio.Queue[sim.ConnectRequest]()

    async def requests() -> AsyncIterator[sim.ConnectRequest]:
        while True:
            yield await waiting.get()

    last = sim.ConnectRequest(step=sim.StepRequest(SESSION, LAST_STEP, np.zeros((1, 2), np.float32)))
    waiting.put_nowait(last)
    assert [reply async for reply in SimClient(channel).connect(requests())] == []

    waiting.put_nowait(last)
    await SegmentationClient(channel).list_skills(SKILLS)
    assert waiting.qsize() == 1


async def test_a_message_of_a_stream_over_the_limit_is_too_large(channel: Channel) -> None:
    async def requests() -> AsyncIterator[sim.ConnectRequest]:
        yield sim.ConnectRequest(
            step=sim.StepRequest(SESSION, 1, np.zeros((1, MAX_MESSAGE_BYTES // 4 + 1), np.float32))
        )

    with pytest.raises(errors.TooLarge):
        await anext(SimClient(channel).connect(requests()))


# --- the connection


async def test_with_root_certificates_the_call_is_over_tls(peer: Peer, certificate: tuple[Path, Path]) -> None:
    key, chain = (path.read_bytes() for path in certificate)
    async with serving(peer, credentials=grpc.ssl_server_credentials([(key, chain)])) as address:
        async with SegmentationClient(Channel(address, root_certificates=chain)) as client:
            assert (await client.list_skills(SKILLS)).height == 2
        async with SimClient(Channel(address)) as client:
            with pytest.raises(errors.Unavailable):
                await client.reset(sim.ResetRequest(SESSION))


async def test_a_service_that_comes_back_is_found_again(peer: Peer, reserve_ports: Any) -> None:
    port = reserve_ports(["sim"])["sim"].grpc
    channel = Channel(f"127.0.0.1:{port}")
    with pytest.raises(errors.Unavailable):
        await SimClient(channel).reset(sim.ResetRequest(SESSION))
    async with serving(peer, port=port), SegmentationClient(channel) as client:
        assert (await client.list_skills(SKILLS)).height == 2


async def test_clients_of_one_address_share_a_channel(channel: Channel, peer: Peer) -> None:
    await SegmentationClient(channel).list_skills(segmentation.ListSkillsRequest(ModelRef("default")))
    await FitClient(channel).start_fit(learning.StartFitRequest("demos"))
    assert peer.calls == ["ListSkills", "StartFit"]
