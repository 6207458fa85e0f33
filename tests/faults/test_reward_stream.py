"""Reward streams over real sockets, with the shipped model: what is answered, refused, and said at the end."""

import asyncio
import signal
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.faults import control_robot as robots

from freerein import images
from freerein.clients import Channel, RewardClient
from freerein.errors import DeadlineExceeded, FailedPrecondition, InvalidInput
from freerein.types.common import Image, ModelRef
from freerein.types.reward import (
    RewardFrame,
    RewardHello,
    RewardRequest,
    RewardStreamRequest,
    RewardStreamResponse,
)

pytestmark = pytest.mark.e2e
GOAL = "a red block on top of a yellow block"
FRAMES = np.random.default_rng(0).integers(0, 255, (6, 48, 64, 3), np.uint8)


@pytest.fixture(scope="module")
def service(start_module_service: Callable[..., Any]) -> Any:
    return start_module_service("freerein_reward").until_ready()


@pytest.fixture
async def client(service: Any) -> AsyncIterator[RewardClient]:
    async with RewardClient(Channel(service.address)) as client:
        yield client


def hello(text: str = GOAL, **options: Any) -> RewardStreamRequest:
    return RewardStreamRequest(RewardHello(text, **options))


def seen(seq: int, *pixels: Any, **frames: Any) -> RewardStreamRequest:
    """Returns a frame: of cameras by name, or as encoded images."""
    return RewardStreamRequest(frame=RewardFrame(seq, frames, tuple(images.encode(each) for each in pixels)))


async def heard(client: RewardClient, *requests: RewardStreamRequest) -> list[RewardStreamResponse]:
    async def said() -> AsyncIterator[RewardStreamRequest]:
        for request in requests:
            yield request

    return [reply async for reply in client.reward_stream(said())]


@pytest.mark.parametrize(
    "options", [{"mode": "binary"}, {"mode": "raw"}, {"mode": "raw", "model": ModelRef("grounding")}], ids=str
)
async def test_each_frame_has_the_bits_of_a_reward_of_that_frame_alone(client: Any, options: dict[str, Any]) -> None:
    sent = [seen(seq, front=frame) if seq % 2 else seen(seq, frame) for seq, frame in enumerate(FRAMES)]
    opened, *replies = await heard(client, hello(**options), *sent)
    alone = [await client.reward(RewardRequest(GOAL, {"front": frame[None]}, **options)) for frame in FRAMES]
    assert [reply.seq for reply in replies] == list(range(len(FRAMES)))
    for reply, expected in zip(replies, alone, strict=True):
        found = reply.reward.reward, reply.reward.similarity, reply.reward.winner, reply.reward.in_distribution
        familiar = expected.in_distribution[0] if len(expected.in_distribution) else None
        assert found == (expected.rewards[0], expected.similarities[0], expected.winners[0], familiar)
    assert (opened.opened.texts, opened.opened.model) == (alone[0].texts, alone[0].model)


@pytest.mark.fault("R7")
async def test_a_bad_frame_is_answered_by_an_error_and_the_stream_goes_on(client: Any) -> None:
    frame = FRAMES[0]
    bad = [
        seen(1, front=frame[:24]),  # another size
        seen(2, frame[:, :32]),
        seen(3, front=frame[None]),
        seen(3, front=frame),  # a number again
        seen(4, frame, frame),
        seen(5),
        RewardStreamRequest(frame=RewardFrame(6, images=(Image("png", 0, 0, b"GIF89a"),))),
        seen(7, front=frame.astype(np.float32)),
    ]
    _, first, *errors, last = await heard(client, hello(), seen(0, front=frame), *bad, seen(8, frame))
    assert [reply.error.code for reply in errors] == ["invalid_input"] * 6 + ["unsupported_media", "invalid_input"]
    assert [reply.error.field for reply in errors] == [
        "frames",
        "images",
        "frames",
        "frame.seq",
        "images",
        "frames",
        "images.0",
        "frames",
    ]
    assert all(reply.error.hint for reply in errors)
    assert replace(last.reward, timing=first.reward.timing) == first.reward


@pytest.mark.fault("R7")
@pytest.mark.parametrize(
    ("requests", "error", "field"),
    [
        ([seen(0, front=FRAMES[0])], FailedPrecondition, "hello"),
        ([hello(), hello()], FailedPrecondition, "frame"),
        ([hello(), RewardStreamRequest()], FailedPrecondition, "frame"),
        ([hello("")], InvalidInput, "goal_text"),
        ([hello("a zeppelin")], InvalidInput, "goal_text"),
        ([hello("a red block")], InvalidInput, "rivals"),
        ([hello(model=ModelRef("grounding"))], InvalidInput, "model"),
        ([hello(model=ModelRef("other"))], FailedPrecondition, "model"),
    ],
    ids=["no hello", "two hellos", "empty", "no words", "unknown noun", "no rivals", "grounding", "no model"],
)
async def test_what_breaks_the_protocol_or_states_no_goal_ends_the_stream(
    client: Any, requests: Any, error: type[Exception], field: str
) -> None:
    with pytest.raises(error) as refused:
        await heard(client, *requests)
    assert (refused.value.field, bool(refused.value.hint)) == (field, True)


@pytest.mark.fault("R7")
async def test_streams_of_many_share_the_model_and_have_the_rewards_of_their_own(client: Any) -> None:
    sent = [seen(seq, front=frame) for seq, frame in enumerate(FRAMES)]
    streams = await asyncio.gather(*(heard(client, hello(mode="raw"), *sent) for _ in range(8)))
    together = await client.reward(RewardRequest(GOAL, {"front": FRAMES}, mode="raw"))
    for _, *replies in streams:
        np.testing.assert_allclose([each.reward.reward for each in replies], together.rewards, atol=1e-5)


async def test_a_deadline_ends_a_stream(client: Any) -> None:
    stream = robots.Stream(lambda requests: client.reward_stream(requests, timeout_s=0.3))
    assert (await stream.ask(hello())).opened is not None
    with pytest.raises(DeadlineExceeded):
        await stream.hear()


@pytest.mark.fault("R7")
async def test_a_stream_is_told_when_the_service_stops(start_service: Callable[..., Any]) -> None:
    own = await asyncio.to_thread(start_service("freerein_reward").until_ready)
    async with RewardClient(Channel(own.address)) as client:
        stream = robots.Stream(client.reward_stream)
        assert (await stream.ask(hello())).opened is not None
        assert (await stream.ask(seen(0, front=FRAMES[0]))).reward is not None
        own.process.send_signal(signal.SIGTERM)
        assert (await stream.hear()).draining.deadline_s > 0
        assert await stream.rest() == []
    assert await asyncio.to_thread(own.process.wait, 60) == 0
