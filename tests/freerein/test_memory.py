"""One budget of bytes for all calls and connections: shares give back what they took, and replies count, too."""

import asyncio
import threading
from dataclasses import dataclass

import numpy as np
import pytest

from freerein.errors import Overloaded
from freerein.serving import memory as memory_module
from freerein.serving.limits import COPIES, MAX_INLINE_BYTES, Limits
from freerein.serving.memory import Memory, Share, encode

pytestmark = pytest.mark.fault("F13")
LIMITS = Limits(buffered_bytes=100)


@dataclass(frozen=True)
class Reply:
    frames: "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]"
    names: tuple[str, ...] = ()
    images: tuple[bytes, ...] = ()
    inner: "Reply | None" = None


def test_shares_take_of_one_budget_and_give_it_back() -> None:
    memory = Memory(LIMITS)
    with memory.share() as first, memory.share() as second:
        first.take(60)
        with pytest.raises(Overloaded, match="At most 100 bytes"):
            second.take(41)
        second.take(40)
        first.resize(20)
        second.resize(80)
        with pytest.raises(Overloaded):
            first.resize(21)
        assert memory.taken == 100
    assert memory.taken == 0


async def test_a_share_of_a_task_is_given_back_at_its_end() -> None:
    memory = Memory(LIMITS)

    async def work() -> None:
        memory.share_of_task().take(100)
        assert memory.taken == 100
        await asyncio.sleep(0)

    task = asyncio.create_task(work())
    await task
    await asyncio.sleep(0)
    assert memory.taken == 0


async def test_a_reply_counts_with_all_its_arrays_texts_and_files() -> None:
    memory = Memory(LIMITS)
    reply = Reply(np.zeros(4, np.uint8), ("ab", "c"), (b"12",), Reply(np.zeros((2, 2), np.uint8)))
    with memory.share() as share:
        assert await encode(reply, lambda each: each.names, share) == ("ab", "c")
        assert memory.taken == COPIES * 13


@pytest.mark.parametrize(("size", "is_inline"), [(MAX_INLINE_BYTES, True), (MAX_INLINE_BYTES + 1, False)])
async def test_a_large_reply_is_encoded_off_the_event_loop(size: int, is_inline: bool) -> None:
    share = Share(Memory(Limits()))
    thread = await encode(Reply(np.zeros(size, np.uint8)), lambda _: threading.current_thread(), share)
    assert (thread is threading.current_thread()) == is_inline


@pytest.mark.parametrize(("size", "alone"), [(2**23 - 1, False), (2**23, True)])
async def test_very_large_replies_are_encoded_one_at_a_time(size: int, alone: bool) -> None:
    memory = Memory(Limits())
    share = Share(memory)
    assert await encode(Reply(np.zeros(size, np.uint8)), lambda _: memory.encoding.locked(), share) is alone


@pytest.mark.parametrize(("most", "left", "trimmed"), [(2**27, 2**25 - 1, [0]), (2**27, 2**25, []), (2**27 - 1, 0, [])])
async def test_many_bytes_that_are_given_back_are_the_system_s_again(
    most: int, left: int, trimmed: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[int] = []
    monkeypatch.setattr(memory_module, "_malloc_trim", called.append)
    memory = Memory(Limits())
    memory.take(most)
    memory.free(most - left)
    await asyncio.get_running_loop().shutdown_default_executor()
    assert called == trimmed


async def test_a_reply_that_is_more_than_is_left_is_refused_before_it_is_encoded() -> None:
    with pytest.raises(Overloaded):
        await encode(Reply(np.zeros(34, np.uint8)), lambda _: pytest.fail("encoded"), Share(Memory(LIMITS)))
