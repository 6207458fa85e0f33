"""Segment streams and videos over real sockets, with models of the real kind: what is labelled, refused, bounded."""

import asyncio
import signal
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import httpx
import numpy as np
import numpy.typing as npt
import psutil
import pytest
import torch
from tests.child_processes import children_running
from tests.faults import control_robot as robots

from freerein.clients import Channel, SegmentationClient
from freerein.errors import FailedPrecondition, InvalidInput, TooLarge
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.model_store import ModelStore
from freerein.types.common import ActionSpec, Camera, ModelRef
from freerein.types.segmentation import (
    ListSkillsRequest,
    SegmentHello,
    SegmentRequest,
    SegmentStreamRequest,
    SegmentStreamResponse,
    Timesteps,
)
from freerein.video import frames_at_rate, open_video
from freerein_segmentation.model import ModelSpec, SegmentationNetwork

pytestmark = pytest.mark.e2e
T = TypeVar("T")
MIB = 2**20
LAG = 6
SPEC = ModelSpec(
    skills=("a", "b", "c"),
    cameras=(Camera("front", 112, 112, 1),),
    action=ActionSpec(2, 0, ("x", "y")),
    use_actions=False,
    context=LAG,
)
WHOLE, TEN_PER_SECOND = ModelRef("whole"), ModelRef("ten-per-second")


def publish(data_dir: Path, name: str, spec: ModelSpec, **data: float) -> None:
    network = SegmentationNetwork(spec)
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    frames = {"front": torch.from_numpy(trajectory(120))}
    network.image.fit_normalisation(frames, generator=torch.Generator())
    with torch.no_grad():  # each skill is as likely as another, so that labels change
        network.head.weight.mul_(30)
        scores, _ = network(frames, torch.zeros(120, 2), torch.tensor([120]))
        network.head.bias -= scores[0].mean(dim=0)
    save_model(network, data_dir / "unpublished", card={"method": "set_supervised", "data": data})
    store = ModelStore(data_dir / "models" / "segmentation")
    store.activate(store.publish(name, data_dir / "unpublished"))


def trajectory(timesteps: int) -> npt.NDArray[np.uint8]:
    """Returns frames, uint8 (T, 112, 112, 1), whose brightness changes every ten timesteps."""
    rng = np.random.default_rng(0)
    bright = np.repeat(rng.integers(0, 200, timesteps // 10 + 1, np.uint8), 10)[:timesteps]
    frames = np.broadcast_to(bright[:, None, None, None], (timesteps, 112, 112, 1)).copy()
    frames[:, :56] += rng.integers(0, 50, (timesteps, 1, 112, 1), np.uint8)
    return frames


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    data_dir = tmp_path_factory.mktemp("data")
    publish(data_dir, "", SPEC)
    publish(data_dir, "whole", replace(SPEC, context="all"))
    publish(data_dir, TEN_PER_SECOND.name, SPEC, fps=10)
    service = start_module_service("freerein_segmentation", data_dir, FREEREIN_WRITE_S="20", FREEREIN_UNARY_S="600")
    return service.until_ready()


@pytest.fixture
async def client(service: Any) -> AsyncIterator[SegmentationClient]:
    async with SegmentationClient(Channel(service.address)) as client:
        yield client


def hello(**options: Any) -> SegmentStreamRequest:
    return SegmentStreamRequest(SegmentHello(**options))


def seen(seq: int, frames: npt.NDArray[np.uint8]) -> SegmentStreamRequest:
    return SegmentStreamRequest(timesteps=Timesteps(seq, frames))


async def said(*requests: SegmentStreamRequest) -> AsyncIterator[SegmentStreamRequest]:
    for request in requests:
        yield request


async def heard(client: SegmentationClient, *requests: SegmentStreamRequest) -> list[SegmentStreamResponse]:
    return [reply async for reply in client.segment_stream(said(*requests))]


@pytest.mark.parametrize(("smoothing", "min_kept"), [(0.0, 0), (1.0, 4)])
async def test_a_stream_has_the_labels_of_the_whole_after_its_lag(client: Any, smoothing: float, min_kept: int) -> None:
    frames = trajectory(120)
    whole = await client.segment(SegmentRequest(frames=frames, smoothing=smoothing, min_kept=min_kept))
    parts = [frames[:1], *np.split(frames[1:20], 19), frames[20:90], frames[90:]]
    requests = [seen(seq, part) for seq, part in enumerate(parts)]
    opened, *replies = await heard(client, hello(smoothing=smoothing, min_kept=min_kept), *requests)

    lag = opened.opened.lag
    assert (opened.opened.model.lag, lag) == (LAG, LAG + (4 + 3 if min_kept else 0))
    pushed = [*np.cumsum([len(part) for part in parts]).tolist(), 120]
    for reply, stop in zip(replies, pushed, strict=True):
        final = reply.labels.start + len(reply.labels.labels)
        assert final + len(reply.labels.provisional) == stop
        assert final >= stop - lag
    assert np.concatenate([reply.labels.labels for reply in replies]).tolist() == whole.labels.tolist()
    segments = [segment for reply in replies for segment in reply.labels.segments]
    assert [(each.start, each.end, each.skill) for each in segments] == [
        (each.start, each.end, each.skill) for each in whole.segments
    ]
    assert len(whole.segments) > 1


@pytest.mark.fault("S11")
async def test_an_invalid_message_is_answered_by_an_error_and_the_stream_goes_on(client: Any) -> None:
    frames = trajectory(20)
    bad = [seen(1, frames[:, :50]), seen(1, frames), seen(2, frames[:0])]
    _, first, *errors, last, end = await heard(client, hello(), seen(0, frames[:10]), *bad, seen(7, frames[10:]))
    assert [error.error.code for error in errors] == ["invalid_input"] * 3
    assert [error.error.field for error in errors] == ["frames", "timesteps.seq", "frames"]
    assert all(error.error.hint for error in errors)
    labels = np.concatenate([reply.labels.labels for reply in (first, last, end)])
    assert labels.tolist() == (await client.segment(SegmentRequest(frames=frames))).labels.tolist()


@pytest.mark.fault("S11")
@pytest.mark.parametrize(
    ("requests", "error"),
    [
        ([seen(0, trajectory(1))], FailedPrecondition),
        ([hello(), hello()], FailedPrecondition),
        ([SegmentStreamRequest()], FailedPrecondition),
        ([hello(smoothing=-1.0)], InvalidInput),
        ([hello(min_kept=1001)], InvalidInput),
        ([hello(min_confidence=1.1)], InvalidInput),
    ],
    ids=["no hello", "two hellos", "empty", "smoothing", "min_kept", "min_confidence"],
)
async def test_what_breaks_the_protocol_ends_the_stream(client: Any, requests: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        await heard(client, *requests)


async def test_a_model_of_whole_trajectories_has_no_stream_and_says_how_to_get_one(client: Any) -> None:
    assert (await client.list_skills(ListSkillsRequest(WHOLE))).lag is None
    with pytest.raises(FailedPrecondition) as refused:
        await heard(client, hello(model=WHOLE))
    assert "context" in refused.value.hint


@pytest.mark.fault("S9")
@pytest.mark.parametrize("timesteps", [6_000, pytest.param(10_000, marks=pytest.mark.long)])
async def test_large_frames_are_labelled_by_a_stream_in_bounded_memory(
    service: Any, client: Any, timesteps: int
) -> None:
    frames = trajectory(timesteps)  # 75 MB and more
    process = psutil.Process(service.process.pid)
    first = await client.segment(SegmentRequest(frames=frames[:1000]))  # for which is allocated what is allocated once
    answer, grown = await watched(process, client.segment(SegmentRequest(frames=frames), timeout_s=600))
    assert (len(answer.labels), answer.segments[0].start, answer.segments[-1].end) == (timesteps, 0, timesteps)
    assert answer.labels[: 1000 - LAG].tolist() == first.labels[: 1000 - LAG].tolist()
    assert grown < 64 * MIB


async def watched(process: psutil.Process, call: Coroutine[Any, Any, T]) -> tuple[T, int]:
    """Returns the answer of a call, and by how many bytes a process grew meanwhile, at most."""
    before = peak = process.memory_info().rss
    answering = asyncio.ensure_future(call)
    while not answering.done():
        await asyncio.wait({answering}, timeout=0.02)
        peak = max(peak, process.memory_info().rss)
    return answering.result(), peak - before


async def test_what_a_stream_cannot_do_is_said_before_it_is_sent(client: Any) -> None:
    frames = np.zeros((6000, 112, 112, 1), np.uint8)
    with pytest.raises(TooLarge, match="merged"):
        await client.segment(SegmentRequest(frames=frames, min_segment=5))
    with pytest.raises(FailedPrecondition):
        await client.segment(SegmentRequest(WHOLE, frames))


@pytest.mark.fault("S11")
async def test_who_does_not_read_is_cut_off_and_nobody_else_waits(service: Any, client: Any) -> None:
    frames = trajectory(400)

    async def flood() -> AsyncIterator[SegmentStreamRequest]:
        yield hello(smoothing=100.0)  # no label is final, and all are repeated as provisional ones
        for seq in range(200):
            yield seen(seq, frames)

    async with SegmentationClient(Channel(service.address)) as slow:
        replies = slow.segment_stream(flood())
        assert (await anext(replies)).opened is not None
        for _ in range(3):
            assert len((await client.segment(SegmentRequest(frames=frames[:20]))).labels) == 20
        await replies.aclose()
    assert len(await heard(client, hello(), seen(0, frames[:20]))) == 3


@pytest.mark.fault("S11")
async def test_a_stream_is_told_when_the_service_stops(start_service: Callable[..., Any], service: Any) -> None:
    own = await asyncio.to_thread(start_service("freerein_segmentation", service.data_dir).until_ready)
    async with SegmentationClient(Channel(own.address)) as client:
        stream = robots.Stream(client.segment_stream)
        assert (await stream.ask(hello())).opened is not None
        assert (await stream.ask(seen(0, trajectory(10)))).labels is not None
        own.process.send_signal(signal.SIGTERM)
        assert (await stream.hear()).draining.deadline_s > 0
        assert await stream.rest() == []
    assert await asyncio.to_thread(own.process.wait, 60) == 0


@pytest.fixture(scope="module")
def video(encode_video: Callable[..., bytes]) -> bytes:
    return encode_video(trajectory(120).repeat(3, axis=3))


@pytest.fixture(scope="module")
def long(encode_video: Callable[..., bytes]) -> bytes:
    return encode_video(np.zeros((2000, 112, 112, 3), np.uint8))


@pytest.fixture(scope="module")
def frames(video: bytes) -> npt.NDArray[np.uint8]:
    with open_video(video, channels=1) as opened:
        return np.stack([frame.pixels for frame in opened])


@pytest.mark.parametrize("model", [ModelRef(), WHOLE], ids=["finite", "whole"])
async def test_a_video_has_the_labels_of_its_frames(
    client: Any, video: bytes, frames: npt.NDArray[np.uint8], model: ModelRef
) -> None:
    expected = await client.segment(SegmentRequest(model, frames))
    answer = await client.segment(SegmentRequest(model, video=video))
    assert answer.labels.tolist() == expected.labels.tolist()
    assert answer.time_s == pytest.approx(np.arange(120) / 10)
    assert expected.time_s.shape == (0,)


async def test_a_video_is_labelled_at_the_rate_that_the_model_was_trained_on_or_another_over_grpc_and_rest(
    service: Any, client: Any, encode_video: Callable[..., bytes], frames: npt.NDArray[np.uint8]
) -> None:
    faster = encode_video(frames[:20].repeat(3, axis=0).repeat(3, axis=3), fps=30)
    every = await client.segment(SegmentRequest(video=faster))
    assert (len(every.labels), every.fps) == (60, 0)  # a model that does not know its rate
    assert (await client.list_skills(ListSkillsRequest(TEN_PER_SECOND))).fps == 10
    with open_video(faster, channels=1) as opened:
        shown = list(opened)
    for fps, count in ((0, 20), (30, 60), (5, 10)):
        answer = await client.segment(SegmentRequest(TEN_PER_SECOND, video=faster, fps=fps))
        rate = fps or 10
        assert (len(answer.labels), answer.fps, answer.model.name) == (count, rate, TEN_PER_SECOND.name)
        assert answer.time_s == pytest.approx(np.arange(count) / rate)
        sampled = np.stack([frame.pixels for frame in frames_at_rate(shown, fps=rate, file="demo.mp4")])
        assert answer.labels.tolist() == (await client.segment(SegmentRequest(TEN_PER_SECOND, sampled))).labels.tolist()
    query = {"model.name": TEN_PER_SECOND.name, "fps": str(fps)}
    async with httpx.AsyncClient(base_url=service.url, timeout=300, trust_env=False, verify=False) as rest:
        over_rest = (await rest.post("/v1/segment", files={"video": ("demo.mp4", faster)}, data=query)).json()
    assert (over_rest["labels"], over_rest["fps"]) == (answer.labels.tolist(), rate)
    with pytest.raises(InvalidInput, match=r"`fps` must be in \[0, 240\]"):
        await client.segment(SegmentRequest(video=faster, fps=241))


@pytest.mark.fault("S10")
async def test_a_video_of_another_size_is_resized_only_when_asked(client: Any, encode_video: Any) -> None:
    wide = encode_video(np.zeros((5, 64, 96, 3), np.uint8))
    with pytest.raises(InvalidInput, match=r"112 x 112; got 64 x 96") as refused:
        await client.segment(SegmentRequest(video=wide))
    assert "resize" in refused.value.hint
    assert len((await client.segment(SegmentRequest(video=wide, resize=True))).labels) == 5


@pytest.mark.fault("S10")
async def test_a_broken_video_is_refused_and_the_service_goes_on(service: Any, client: Any, video: bytes) -> None:
    damaged = bytearray(video)
    damaged[len(video) // 2 :: 97] = b"\xff" * len(damaged[len(video) // 2 :: 97])
    for broken in (video[:-100], bytes(damaged)):
        with pytest.raises(InvalidInput, match="corrupt or truncated"):
            await client.segment(SegmentRequest(video=broken))
    assert len((await client.segment(SegmentRequest(video=video))).labels) == 120


@pytest.mark.fault("S10")
async def test_a_decoder_that_crashes_fails_its_call_alone(
    service: Any, client: Any, long: bytes, wait_until: Any
) -> None:
    call = asyncio.ensure_future(client.segment(SegmentRequest(video=long), timeout_s=600))
    await asyncio.to_thread(wait_until, lambda: decoders(service), 300)
    decoders(service)[0].send_signal(signal.SIGSEGV)
    with pytest.raises(InvalidInput, match="corrupt or truncated"):
        await call
    assert len((await client.segment(SegmentRequest(frames=trajectory(5)))).labels) == 5


@pytest.mark.fault("S10")
async def test_a_call_that_is_given_up_ends_its_decoder(
    service: Any, client: Any, long: bytes, wait_until: Any
) -> None:
    call = asyncio.ensure_future(client.segment(SegmentRequest(video=long)))
    await asyncio.to_thread(wait_until, lambda: decoders(service), 300)
    call.cancel()
    await asyncio.to_thread(wait_until, lambda: not decoders(service), 300)


def decoders(service: Any) -> list[psutil.Process]:
    return children_running("freerein.video.decoder", service.process.pid)


@pytest.mark.long
@pytest.mark.fault("S9")
async def test_a_video_of_ten_thousand_frames_is_labelled_in_bounded_memory(
    service: Any, client: Any, encode_video: Any
) -> None:
    long = encode_video(np.arange(10_000)[:, None, None, None].astype(np.uint8) * np.ones((112, 112, 3), np.uint8))
    await client.segment(SegmentRequest(frames=trajectory(1000)))  # what is allocated once
    answer, grown = await watched(
        psutil.Process(service.process.pid), client.segment(SegmentRequest(video=long), timeout_s=600)
    )
    assert len(answer.labels) == 10_000
    assert grown < 64 * MIB
