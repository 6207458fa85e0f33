"""Items and the thread that runs the model: nothing waits that need not, and nothing is computed for nobody."""

import asyncio
import threading
import time
import traceback
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from freerein.errors import DeadlineExceeded, InvalidInput, ModelFault, Overloaded, ServiceError, Unavailable
from freerein.serving.batcher import Batcher, BatchResult
from freerein.serving.metrics import Metrics


class Model:
    """Doubles numbers, raises on 13, refuses 7, answers one item of several for 99; waits at a gate when told to."""

    def __init__(self) -> None:
        self.batches: list[list[int]] = []
        self.begun = threading.Semaphore(0)
        self.gate = threading.Event()
        self.gate.set()

    def __call__(self, items: Sequence[int]) -> list[int | ServiceError]:
        self.batches.append(list(items))
        self.begun.release()
        self.gate.wait(60)
        if 13 in items:
            raise ZeroDivisionError("13 at 0x7f0000000000")
        if 99 in items:
            return [0]
        return [InvalidInput("No sevens.") if item == 7 else 2 * item for item in items]


@pytest.fixture
def model() -> Model:
    return Model()


@pytest.fixture
async def batcher(model: Model) -> AsyncIterator[Batcher[int, int]]:
    batcher = Batcher(model, queue=4, batch=3, metrics=Metrics())
    yield batcher
    model.gate.set()
    batcher.close()


async def busy(batcher: Batcher[int, int], model: Model) -> "asyncio.Task[BatchResult[int]]":
    """Returns the call that holds the model until the gate is opened."""
    model.gate.clear()
    call = asyncio.create_task(batcher.submit(0, timeout_s=60))
    await asyncio.to_thread(model.begun.acquire)
    return call


async def waiting(batcher: Batcher[int, int], *items: int, key: str = "") -> "list[asyncio.Task[BatchResult[int]]]":
    calls = [asyncio.create_task(batcher.submit(item, key=key, timeout_s=60)) for item in items]
    await asyncio.sleep(0)
    return calls


async def test_items_of_one_call_share_a_batch_with_no_others(batcher: Batcher[int, int], model: Model) -> None:
    first = await busy(batcher, model)
    (other,) = await waiting(batcher, 1)
    call = asyncio.create_task(batcher.submit_batch([2, 7, 3]))
    await asyncio.sleep(0)
    model.gate.set()
    done = await call
    await asyncio.gather(first, other)
    assert model.batches == [[0], [1], [2, 7, 3]]
    assert [each.output if isinstance(each, BatchResult) else each.code for each in done] == [4, "invalid_input", 6]
    await batcher.submit_batch(range(21, 26))
    assert model.batches[3:] == [[21, 22, 23], [24, 25]]


async def test_a_lone_item_runs_at_once_and_alone(batcher: Batcher[int, int]) -> None:
    done = await batcher.submit(21, timeout_s=60)
    assert (done.output, done.batch_size) == (42, 1)
    assert time.perf_counter_ns() - done.submitted_ns < 60e9
    assert 0 < done.infer_ns < 60e9


async def test_its_thread_enters_one_function_before_the_model() -> None:
    """As `docs/architecture.md` says: the frames of a call are counted."""

    def callers(_items: Sequence[int]) -> list[list[str]]:
        return [[each.filename for each in traceback.extract_stack() if "serving" in each.filename]]

    batcher: Batcher[int, list[str]] = Batcher(callers, queue=1, batch=1, metrics=Metrics())
    assert [Path(each).name for each in (await batcher.submit(0)).output] == ["batcher.py"]
    batcher.close()


async def test_what_arrives_while_the_model_is_busy_shares_the_next_call(
    batcher: Batcher[int, int], model: Model
) -> None:
    first = await busy(batcher, model)
    calls = await waiting(batcher, 1, 2, 3, 4)
    model.gate.set()
    assert [(await call).output for call in (first, *calls)] == [0, 2, 4, 6, 8]
    assert model.batches == [[0], [1, 2, 3], [4]]


async def test_only_items_of_one_key_share_a_call(batcher: Batcher[int, int], model: Model) -> None:
    await busy(batcher, model)
    calls = [*await waiting(batcher, 1, 2, key="a"), *await waiting(batcher, 3, key="b")]
    model.gate.set()
    await asyncio.gather(*calls)
    assert model.batches[1:] == [[1, 2], [3]]


async def test_one_more_than_may_wait_is_refused_and_told_when_to_come_back(
    batcher: Batcher[int, int], model: Model
) -> None:
    await busy(batcher, model)
    calls = await waiting(batcher, 1, 2, 3, 4)
    with pytest.raises(Overloaded, match="At most 4") as error:
        await batcher.submit(5, timeout_s=60)
    assert error.value.retry_after_s
    model.gate.set()
    assert [done.output for done in await asyncio.gather(*calls)] == [2, 4, 6, 8]


async def test_an_item_whose_caller_is_gone_frees_its_place_and_never_reaches_the_model(
    batcher: Batcher[int, int], model: Model
) -> None:
    await busy(batcher, model)
    calls = await waiting(batcher, 1, 2, 3, 4)
    for call in calls[:3]:
        call.cancel()
    await asyncio.gather(*calls[:3], return_exceptions=True)
    calls += await waiting(batcher, 5, 6, 7)
    model.gate.set()
    assert (await calls[3]).output == 8
    await asyncio.gather(*calls, return_exceptions=True)
    assert model.batches[1:] == [[4, 5, 6], [7]]


async def test_an_item_cancelled_a_moment_ago_never_reaches_the_model(batcher: Batcher[int, int], model: Model) -> None:
    await busy(batcher, model)
    calls = await waiting(batcher, 1, 2)
    calls[0].cancel()
    model.gate.set()
    assert model.begun.acquire(timeout=60)  # before the loop, which this blocks, can remove the item
    assert model.batches[1:] == [[2]]
    await asyncio.gather(*calls, return_exceptions=True)


async def test_an_item_that_waited_too_long_is_dropped(batcher: Batcher[int, int], model: Model) -> None:
    await busy(batcher, model)
    call = asyncio.create_task(batcher.submit(1, timeout_s=0))
    await asyncio.sleep(0)
    model.gate.set()
    with pytest.raises(DeadlineExceeded):
        await call
    assert model.batches == [[0]]


async def test_one_poisonous_item_fails_alone(batcher: Batcher[int, int], model: Model) -> None:
    await busy(batcher, model)
    calls = await waiting(batcher, 1, 13, 7)
    model.gate.set()
    results = await asyncio.gather(*calls, return_exceptions=True)
    assert isinstance(results[0], BatchResult)
    assert (results[0].output, results[0].batch_size) == (2, 1)
    assert isinstance(results[1], ModelFault)
    assert "0x" not in results[1].detail
    assert type(results[2]) is InvalidInput


async def test_an_answer_for_fewer_items_is_a_fault_of_the_model(batcher: Batcher[int, int], model: Model) -> None:
    await busy(batcher, model)
    calls = await waiting(batcher, 99, 1)
    model.gate.set()
    first, second = await asyncio.gather(*calls)
    assert (first.output, second.output) == (0, 2)


async def test_five_failures_in_a_row_make_it_not_ready_until_a_call_succeeds(batcher: Batcher[int, int]) -> None:
    for _ in range(5):
        assert not batcher.not_ready()
        with pytest.raises(ModelFault):
            await batcher.submit(13, timeout_s=60)
    assert batcher.not_ready()
    await batcher.submit(1, timeout_s=60)
    for _ in range(4):
        with pytest.raises(ModelFault):
            await batcher.submit(13, timeout_s=60)
    assert not batcher.not_ready()


@pytest.mark.fault("C16")
async def test_after_five_failures_it_is_ready_again_without_a_call_and_not_after_the_next(
    model: Model, wait_until: Any
) -> None:
    batcher: Batcher[int, int] = Batcher(model, queue=4, batch=3, metrics=Metrics(), call_s=0.2)

    async def fail() -> float:
        """Lets a call fail; returns for how many seconds it was not ready from then on."""
        begun = time.monotonic()
        with pytest.raises(ModelFault):
            await batcher.submit(13, timeout_s=60)
        await asyncio.to_thread(wait_until, lambda: not batcher.not_ready(), 60)
        return time.monotonic() - begun

    for _ in range(4):
        with pytest.raises(ModelFault):
            await batcher.submit(13, timeout_s=60)
    assert [await fail() >= 0.2 for _ in range(2)] == [True, True]
    batcher.close()


async def test_what_waits_is_measured_until_it_is_refused_by_closing(model: Model) -> None:
    metrics = Metrics()
    batcher = Batcher(model, queue=4, batch=3, metrics=metrics)
    first = await busy(batcher, model)
    calls = await waiting(batcher, 1, 2)
    assert metrics.registry.get_sample_value("freerein_queued_items") == 2
    closing = asyncio.create_task(asyncio.to_thread(batcher.close))
    await asyncio.wait(calls)
    model.gate.set()
    await asyncio.gather(first, closing)
    assert metrics.registry.get_sample_value("freerein_queued_items") == 0
    assert metrics.registry.get_sample_value("freerein_batch_size_sum") == 1


async def test_its_thread_ends_when_closed_and_holds_up_no_exit(model: Model) -> None:
    others = set(threading.enumerate())
    batcher = Batcher(model, queue=4, batch=3, metrics=Metrics())
    (thread,) = set(threading.enumerate()) - others
    assert (thread.name, thread.daemon) == ("model", True)
    batcher.close()
    thread.join(60)
    assert not thread.is_alive()


async def test_an_idle_batcher_takes_no_time_of_the_processor(batcher: Batcher[int, int]) -> None:
    await batcher.submit(1, timeout_s=60)
    begun = time.process_time()
    await asyncio.sleep(0.2)  # what is measured is this span
    assert time.process_time() - begun < 0.1


async def test_a_call_that_takes_long_is_stuck_then_hangs_until_it_ends(model: Model, wait_until: Any) -> None:
    metrics = Metrics()
    batcher: Batcher[int, int] = Batcher(model, queue=4, batch=3, metrics=metrics, call_s=0.05)

    def stuck() -> float | None:
        return metrics.registry.get_sample_value("freerein_stuck_threads")

    assert (batcher.not_ready(), batcher.hangs(), stuck()) == ("", False, 0)

    begun = time.monotonic()
    call = await busy(batcher, model)
    await asyncio.to_thread(wait_until, lambda: batcher.not_ready() != "", 60)
    assert time.monotonic() - begun > 0.05
    assert batcher.not_ready() == "The model has been busy with one call for more than 0.05 s."
    assert stuck() == 1
    await asyncio.to_thread(wait_until, batcher.hangs, 60)
    assert time.monotonic() - begun > 4 * 0.05

    model.gate.set()
    await call
    assert (batcher.not_ready(), batcher.hangs(), stuck()) == ("", False, 0)
    batcher.close()


async def test_closed_it_refuses_what_waits_and_what_comes(batcher: Batcher[int, int], model: Model) -> None:
    first = await busy(batcher, model)
    calls = await waiting(batcher, 1)
    closing = asyncio.create_task(asyncio.to_thread(batcher.close))
    with pytest.raises(Unavailable):
        await calls[0]
    model.gate.set()
    assert (await first).output == 0
    await closing
    with pytest.raises(Unavailable):
        await batcher.submit(1, timeout_s=60)


async def test_what_a_batch_that_fails_leaves_is_refused_once_closed(wait_until: Any) -> None:
    begun, ends = threading.Semaphore(0), threading.Semaphore(0)

    def fail(_items: Sequence[int]) -> list[int]:
        begun.release()
        ends.acquire()
        raise ZeroDivisionError

    batcher: Batcher[int, int] = Batcher(fail, queue=4, batch=3, metrics=Metrics())
    calls = await waiting(batcher, 0)
    await asyncio.to_thread(begun.acquire)
    calls += await waiting(batcher, 1, 2)
    ends.release()
    await asyncio.to_thread(begun.acquire)
    closing = asyncio.create_task(asyncio.to_thread(batcher.close))
    await asyncio.to_thread(wait_until, lambda: batcher._closed, 60)
    ends.release()
    failed = await asyncio.gather(*calls, return_exceptions=True)
    assert [type(error) for error in failed] == [ModelFault, Unavailable, Unavailable]
    await closing


@given(
    items=st.lists(st.tuples(st.integers(0, 12), st.sampled_from("ab"), st.booleans()), max_size=30),
    queue=st.integers(1, 30),
    batch=st.integers(1, 5),
)
def test_whatever_is_cancelled_each_caller_gets_its_own_answer(
    items: list[tuple[int, str, bool]], queue: int, batch: int
) -> None:
    async def scenario() -> None:
        metrics, model = Metrics(), Model()
        batcher = Batcher(model, queue=queue, batch=batch, metrics=metrics)
        calls = [asyncio.create_task(batcher.submit(item, key=key, timeout_s=60)) for item, key, _ in items]
        await asyncio.sleep(0)
        for call, (_, _, cancelled) in zip(calls, items, strict=True):
            if cancelled:
                call.cancel()
        results = await asyncio.gather(*calls, return_exceptions=True)
        for (item, _, cancelled), result in zip(items, results, strict=True):
            if isinstance(result, BatchResult):
                assert result.output == 2 * item
            else:
                assert isinstance(result, (asyncio.CancelledError, Overloaded)) or (item == 7 and not cancelled)
        assert all(len(items) <= batch for items in model.batches)
        assert metrics.registry.get_sample_value("freerein_queued_items") == 0
        batcher.close()

    asyncio.run(scenario())


@pytest.mark.fault("C17")
async def test_a_batch_that_fails_and_is_tried_one_by_one_is_no_call_that_hangs() -> None:
    begun, others_wait, seen = threading.Semaphore(0), threading.Event(), []

    def slow(items: Sequence[int]) -> list[int]:
        begun.release()
        seen.append((batcher.not_ready(), batcher.hangs()))
        others_wait.wait(60)
        threading.Event().wait(0.1)
        seen.append((batcher.not_ready(), batcher.hangs()))
        if 13 in items:
            raise ZeroDivisionError
        return list(items)

    batcher: Batcher[int, int] = Batcher(slow, queue=64, batch=32, metrics=Metrics(), call_s=1.0)
    first = asyncio.create_task(batcher.submit(0, timeout_s=60))  # the others wait for it, and become a batch
    await asyncio.to_thread(begun.acquire)
    others = [asyncio.create_task(batcher.submit(item, timeout_s=60)) for item in range(1, 33)]
    await asyncio.sleep(0)
    others_wait.set()
    results = await asyncio.gather(*others, return_exceptions=True)
    await first
    batcher.close()
    assert sum(isinstance(result, ModelFault) for result in results) == 1
    assert len(seen) > 2 * 32 * 0.9
    assert seen.count(("", False)) > 0.9 * len(seen)  # a busy machine may hold up a call
