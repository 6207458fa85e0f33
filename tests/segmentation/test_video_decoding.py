"""Videos that are decoded for callers: places are held until decoders have ended, and callers that leave end theirs."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, suppress
from typing import Any

import numpy as np
import psutil
import pytest
from tests.child_processes import children_running
from tests.waiting import wait_until

from freerein.errors import InvalidInput, Overloaded
from freerein.types.common import Camera
from freerein.video import VideoBounds, reader
from freerein_segmentation.core import video_decoding
from freerein_segmentation.core.video_decoding import VideoChunk, VideoDecoding

pytestmark = pytest.mark.fault("F14")
CAMERA = Camera("front", 64, 64, 3)
AT_ONCE = 2


@pytest.fixture(scope="module")
def video(encode_video: Callable[..., bytes]) -> bytes:
    return encode_video(np.zeros((600, 64, 64, 3), np.uint8))


@pytest.fixture
def videos() -> VideoDecoding:
    return VideoDecoding(AT_ONCE)


def decoders() -> list[psutil.Process]:
    return children_running("freerein.video.decoder")


async def first_chunk(videos: VideoDecoding, video: bytes) -> VideoChunk | None:
    async with aclosing(videos.frames(video, CAMERA, resize=False)) as chunks:
        return await anext(chunks, None)


async def leave(call: "asyncio.Task[Any]") -> None:
    """Cancels a call, and returns when it has ended."""
    call.cancel()
    await asyncio.wait({call}, timeout=60)
    assert call.cancelled()


async def until(condition: Callable[[], Any]) -> None:
    await asyncio.to_thread(wait_until, condition)


@pytest.fixture
def no_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes decoders that yield nothing, and are given all the time: they are suspended as they start."""
    spawn = reader._spawn

    def spawn_suspended(*arguments: Any) -> Any:
        spawned = spawn(*arguments)
        psutil.Process(spawned[0].pid).suspend()
        return spawned

    monkeypatch.setattr(reader, "_spawn", spawn_suspended)
    monkeypatch.setattr(video_decoding, "_BOUNDS", VideoBounds(first_frame_s=600.0))


@pytest.mark.usefixtures("no_frames")
async def test_a_caller_that_leaves_without_a_frame_ends_its_decoder(videos: VideoDecoding, video: bytes) -> None:
    for _ in range(2 * AT_ONCE):
        call = asyncio.create_task(first_chunk(videos, video))
        await until(decoders)
        await leave(call)
        assert not decoders()


@pytest.mark.usefixtures("no_frames")
async def test_a_caller_that_leaves_as_its_decoder_starts_ends_it_too(videos: VideoDecoding, video: bytes) -> None:
    for ticks in range(4):
        call = asyncio.create_task(first_chunk(videos, video))
        for _ in range(ticks):
            await asyncio.sleep(0)
        await leave(call)
        assert not decoders()


@pytest.mark.usefixtures("no_frames")
async def test_more_videos_than_places_are_refused_at_once(videos: VideoDecoding, video: bytes) -> None:
    calls = [asyncio.create_task(first_chunk(videos, video)) for _ in range(AT_ONCE)]
    await until(lambda: len(decoders()) == AT_ONCE)
    for _ in range(3):
        with pytest.raises(Overloaded, match=f"At most {AT_ONCE} videos"):
            await first_chunk(videos, video)
    for call in calls:
        await leave(call)
    assert videos._slots.taken == 0


async def test_a_place_is_held_until_the_decoder_has_ended(
    videos: VideoDecoding, video: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    closing, may_close = asyncio.Event(), asyncio.Event()
    loop, close = asyncio.get_running_loop(), reader.Video.close

    def close_when_told(self: reader.Video) -> None:
        loop.call_soon_threadsafe(closing.set)
        asyncio.run_coroutine_threadsafe(may_close.wait(), loop).result(60)
        close(self)

    monkeypatch.setattr(reader.Video, "close", close_when_told)
    call = asyncio.create_task(first_chunk(videos, video))
    await closing.wait()
    call.cancel()
    with suppress(TimeoutError):
        await asyncio.wait_for(asyncio.shield(call), 0.05)
    assert (call.done(), videos._slots.taken) == (False, 1)
    may_close.set()
    with pytest.raises(asyncio.CancelledError):
        await call
    assert (decoders(), videos._slots.taken) == ([], 0)


async def test_a_caller_that_leaves_between_frames_ends_its_decoder(videos: VideoDecoding, video: bytes) -> None:
    chunk = await first_chunk(videos, video)
    assert chunk is not None
    assert chunk.frames.shape[1:] == (64, 64, 3)
    assert not decoders()


async def test_a_video_is_decoded_to_its_end(videos: VideoDecoding, video: bytes) -> None:
    chunks: AsyncIterator[VideoChunk] = videos.frames(video, CAMERA, resize=False)
    assert sum([len(chunk.frames) async for chunk in chunks]) == 600
    assert (decoders(), videos._slots.taken) == ([], 0)


async def test_what_is_no_video_gives_its_place_back(videos: VideoDecoding) -> None:
    for _ in range(2 * AT_ONCE):
        with pytest.raises(InvalidInput):
            await first_chunk(videos, b"\0\0\0\x18ftypmp42" + bytes(12))
    assert videos._slots.taken == 0
