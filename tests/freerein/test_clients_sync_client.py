"""A client without asyncio, against a peer that speaks gRPC and nothing of ours."""
# ruff: noqa: N802 -- gRPC names the methods

import gc
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import grpc
import pytest

from freerein import wire
from freerein.api.learning.v1 import learning_pb2_grpc
from freerein.clients import Channel, FitClient, SyncClient
from freerein.errors import Cancelled, FailedPrecondition, NotFound
from freerein.types.learning import (
    Fit,
    GetFitRequest,
    GetFitResponse,
    ListFitsRequest,
    ListFitsResponse,
    WatchFitRequest,
    WatchFitResponse,
)

FIT = Fit("0" * 32, "running", {}, dataset="demos", model_name="default")


class Fits(learning_pb2_grpc.FitServiceServicer):
    """Every fit is known but `unknown`, and `slow` is never told of and has no event; events of others have no end."""

    def __init__(self) -> None:
        self.called = threading.Event()
        self.watch_ended = threading.Event()

    def GetFit(self, request, context):
        if request.id == "slow":
            ended = threading.Event()
            context.add_callback(ended.set)
            self.called.set()
            ended.wait()
        if request.id == "unknown":
            context.abort(grpc.StatusCode.NOT_FOUND, "no such fit")
        return wire.pack(GetFitResponse(FIT))

    def ListFits(self, request, context):
        return wire.pack(ListFitsResponse((FIT, FIT)))

    def WatchFit(self, request, context):
        ended = threading.Event()  # of this attempt: where the connection is lost the client makes another
        context.add_callback(ended.set)
        context.add_callback(self.watch_ended.set)
        self.called.set()
        if request.id == "slow":
            ended.wait()
        sequence = 0
        while not ended.wait(1e-3):
            yield wire.pack(WatchFitResponse(sequence, FIT))
            sequence += 1


@pytest.fixture
def service() -> Fits:
    return Fits()


@pytest.fixture
def channel(service: Fits) -> Iterator[Channel]:
    server = grpc.server(ThreadPoolExecutor(4))
    learning_pb2_grpc.add_FitServiceServicer_to_server(service, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield Channel(f"127.0.0.1:{port}")
    server.stop(None).wait()


def test_coroutines_become_calls_and_asynchronous_iterators_iterators(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client:
        assert client.list_fits(ListFitsRequest()).fits == (FIT, FIT)
        events = client.watch_fit(WatchFitRequest(FIT.id))
        assert [next(events).sequence for _ in range(3)] == [0, 1, 2]


def test_an_iterator_that_is_closed_ends_its_call(channel: Channel, service: Fits) -> None:
    with SyncClient(FitClient(channel)) as client:
        events = client.watch_fit(WatchFitRequest(FIT.id))
        next(events)
        events.close()
        assert service.watch_ended.wait(60)


def test_closing_the_client_ends_its_streams_and_its_thread(channel: Channel, service: Fits) -> None:
    client = SyncClient(FitClient(channel))
    events = client.watch_fit(WatchFitRequest(FIT.id))
    next(events)
    client.close()
    client.close()
    assert service.watch_ended.wait(60)
    assert "FitClient" not in {thread.name for thread in threading.enumerate()}
    with pytest.raises(FailedPrecondition, match="it is closed"):
        next(events)


def test_closing_the_client_cancels_the_calls_of_other_threads(channel: Channel, service: Fits) -> None:
    client = SyncClient(FitClient(channel))
    with ThreadPoolExecutor(1) as thread:
        call = thread.submit(client.get_fit, GetFitRequest("slow"))
        assert service.called.wait(60)
        client.close()
        with pytest.raises(Cancelled):
            call.result()


@pytest.fixture
def _hearing_ctrl_c() -> Iterator[None]:
    """Ctrl-C interrupts, although whoever started the tests in the background made it do nothing."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_hearing_ctrl_c")
def test_an_interrupt_ends_a_stream_that_has_no_reply_yet(channel: Channel, service: Fits) -> None:
    with SyncClient(FitClient(channel)) as client:
        events = client.watch_fit(WatchFitRequest("slow"))
        main = threading.main_thread().ident
        interrupt = threading.Thread(
            target=lambda: service.called.wait(60) and signal.pthread_kill(main, signal.SIGINT)
        )
        interrupt.start()
        with pytest.raises(KeyboardInterrupt):
            next(events)
        interrupt.join()
        assert service.watch_ended.wait(60)
        assert client.list_fits(ListFitsRequest()).fits == (FIT, FIT)


class Collecting(FitClient):
    """Collects garbage on the event loop's thread, as Python may at any time."""

    async def collect(self) -> int:
        return gc.collect()


def test_a_stream_that_is_garbage_on_the_thread_of_the_loop_does_not_hold_it_up(
    channel: Channel, service: Fits
) -> None:
    def forget(events: Iterator[WatchFitResponse]) -> None:
        cycle: list[object] = [events]
        cycle.append(cycle)

    with SyncClient(Collecting(channel)) as client:
        events = client.watch_fit(WatchFitRequest(FIT.id))
        next(events)
        forget(events)
        del events
        client.collect()
        assert service.watch_ended.wait(60)
        assert client.list_fits(ListFitsRequest()).fits == (FIT, FIT)


def test_an_exhausted_iterator_stays_so(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client:
        events = client.watch_fit(WatchFitRequest(FIT.id))
        events.close()
        assert list(events) == []


def test_errors_are_the_clients(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client, pytest.raises(NotFound, match="no such fit"):
        client.get_fit(GetFitRequest("unknown"))


def test_a_closed_client_says_so(channel: Channel) -> None:
    client = SyncClient(FitClient(channel))
    client.close()
    with pytest.raises(FailedPrecondition, match="it is closed"):
        client.list_fits(ListFitsRequest())


def test_a_method_that_the_client_does_not_have_is_an_attribute_error(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client, pytest.raises(AttributeError, match="start_fire"):
        client.start_fire()


async def test_it_works_where_an_event_loop_runs_already(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client:
        assert client.get_fit(GetFitRequest(FIT.id)).fit == FIT


def test_several_threads_may_call_at_once(channel: Channel) -> None:
    with SyncClient(FitClient(channel)) as client, ThreadPoolExecutor(4) as threads:
        replies = list(threads.map(lambda _: client.get_fit(GetFitRequest(FIT.id)), range(16)))
    assert [reply.fit for reply in replies] == [FIT] * 16


def test_a_forgotten_client_ends_its_thread(channel: Channel) -> None:
    client = SyncClient(FitClient(channel))
    client.list_fits(ListFitsRequest())
    [thread] = [thread for thread in threading.enumerate() if thread.name == "FitClient"]
    del client
    gc.collect()
    assert not thread.is_alive()
