"""Fits: what was acknowledged is never lost, whoever dies, and every fit ends as what it is."""

import asyncio
import json
import logging
import os
import shutil
import signal
import textwrap
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest

from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, Overloaded
from freerein.jobs import queue, retry
from freerein.model_store import ModelStore
from freerein.serving.fits import FitService
from freerein.serving.health import Health
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.learning import (
    CancelFitRequest,
    DeleteFitRequest,
    Fit,
    GetFitRequest,
    ListFitsRequest,
    ResumeFitRequest,
    StartFitRequest,
    WatchFitRequest,
)

CHILD = textwrap.dedent(
    """
    import json, os, signal, sys, time
    from pathlib import Path

    work = Path(sys.argv[1])
    config = json.loads((work / "config.json").read_text())["config"]
    runs = work / "runs.txt"
    runs.write_text((runs.read_text() if runs.exists() else "") + f"{os.getpid()}\\n")
    behaviour = config["behaviour"]
    if behaviour == "killed" and len(runs.read_text().split()) <= 4 or behaviour == "always killed":
        os.kill(os.getpid(), signal.SIGKILL)
    with (work / "metrics.jsonl").open("a") as metrics:
        step = 2 * len(runs.read_text().split())
        metrics.write(f'{{"step": {step}, "train_loss": 0.5, "validation_loss": NaN}}\\n')
    if behaviour == "burst":
        with (work / "metrics.jsonl").open("a") as metrics:
            metrics.writelines(f'{{"step": {step}, "train_loss": {1 / step}}}\\n' for step in range(3, 6))
    if behaviour == "permanent":
        sys.stderr.write("The dataset must hold two skills; it holds one.\\n")
        sys.exit(2)
    if behaviour == "broken metrics":
        with (work / "metrics.jsonl").open("a") as metrics:
            metrics.write("not JSON\\n")
    if behaviour in ("wait", "broken metrics"):
        sys.stdin.read()
        sys.exit(1)
    (work / "model").mkdir()
    (work / "model" / "card.json").write_text(json.dumps({"steps": config["steps"]}))
    """
)


def resolve(dataset: str, config: Mapping[str, Any]) -> dict[str, Any]:
    if dataset != "demos":
        raise NotFound("No such dataset.", field="dataset")
    if unknown := set(config) - {"behaviour", "steps"}:
        raise InvalidInput(f"{len(unknown)} unknown.", field="config")
    return {"behaviour": "succeed", "steps": 5, **config}


def load(folder: Path) -> str:
    if json.loads((folder / "card.json").read_text())["steps"] > 5:
        raise InvalidInput("`width` must be in [4, 1024]; got 1280.", hint="Record anew.")
    return folder.name


class Bench:
    """One service's fits, which can be left behind and started again on the same disk."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.store = ModelStore(root / "models")
        self.models = ModelCache(self.store, load, fit_command="freerein fit toy")

    @asynccontextmanager
    async def running(self, resolve: Callable[..., dict[str, Any]] = resolve) -> AsyncIterator[FitService]:
        health = Health()
        fits = FitService(
            self.root / "fits",
            module="child",
            store=self.store,
            models=self.models,
            resolve=resolve,
            health=health,
        )
        await fits.start()
        try:
            yield fits
        finally:
            health.drain()
            await fits.close()

    def folder(self, fit: Fit) -> Path:
        return self.root / "fits" / fit.id

    def runs(self, fit: Fit) -> list[int]:
        return [int(line) for line in (self.folder(fit) / "runs.txt").read_text().split()]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    (tmp_path / "child.py").write_text(CHILD)
    monkeypatch.chdir(tmp_path)  # `python -m` finds the child there
    return Bench(tmp_path)


async def begin(fits: FitService, behaviour: str = "succeed", key: str = "") -> Fit:
    return (await fits.start_fit(StartFitRequest("demos", "", {"behaviour": behaviour}, key))).fit


async def when(fits: FitService, fit: Fit, condition: Callable[[Fit], object]) -> Fit:
    """Returns the fit at its first event that meets a condition."""
    async for event in fits.watch_fit(WatchFitRequest(fit.id)):
        if condition(event.fit):
            return event.fit
    pytest.fail(f"the fit ended as {(await fits.get_fit(GetFitRequest(fit.id))).fit}")


async def end(fits: FitService, fit: Fit) -> Fit:
    return await when(fits, fit, lambda now: now.ended)


async def test_a_fit_that_succeeds_makes_a_model_that_is_active(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await end(fits, await begin(fits))
    assert fit.state == "succeeded"
    assert fit.model is not None
    assert fit.metrics == {"train_loss": 0.5}  # NaN is no figure
    assert bench.store.active_version("default") == fit.model.version
    assert bench.store.models()[0].card == {"steps": 5}


@pytest.mark.fault("F8")
async def test_kills_from_outside_before_the_first_progress_are_no_failures_of_the_fit(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retry, "_FIRST_PAUSE_S", 0.01)
    async with bench.running() as fits:
        fit = await end(fits, await begin(fits, "killed"))
    assert (fit.state, fit.error, len(bench.runs(fit))) == ("succeeded", "", 5)


@pytest.mark.fault("F8")
async def test_a_fit_that_is_always_killed_makes_way_for_the_next_and_says_why(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retry, "_FIRST_PAUSE_S", 0.001)
    async with bench.running() as fits:
        killed, other = await begin(fits, "always killed"), await begin(fits)
        assert (await end(fits, other)).state == "succeeded"
        killed = await end(fits, killed)
    assert (killed.state, len(bench.runs(killed))) == ("failed", 10)
    assert killed.error == (
        "10 attempts in a row ended without progress. The child process was killed by SIGKILL, or memory ran out."
    )


@pytest.mark.fault("F8")
async def test_a_fit_that_waits_for_its_next_attempt_says_so_and_is_cancelled_at_once(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retry, "_FIRST_PAUSE_S", 60.0)
    async with bench.running() as fits:
        waiting = await when(fits, await begin(fits, "killed"), lambda now: now.error)
        assert (waiting.state, waiting.step) == ("running", 0)
        assert waiting.error.endswith("was killed by SIGKILL, or memory ran out. The next attempt begins after 60 s.")
        async with asyncio.timeout(50):
            assert (await fits.cancel_fit(CancelFitRequest(waiting.id))).fit.state == "cancelled"
            assert (await end(fits, await begin(fits))).state == "succeeded"
    assert len(bench.runs(waiting)) == 1


async def test_a_permanent_failure_is_not_retried(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await end(fits, await begin(fits, "permanent"))
    assert (fit.state, fit.error) == ("failed", "The dataset must hold two skills; it holds one.")
    assert len(bench.runs(fit)) == 1


async def test_a_model_that_cannot_be_loaded_fails_its_fit_and_the_active_one_stays(bench: Bench) -> None:
    async with bench.running() as fits:
        good = await end(fits, await begin(fits))
        bad = await end(fits, (await fits.start_fit(StartFitRequest("demos", "", {"steps": 1280}))).fit)
    assert good.model is not None
    assert (bad.state, bad.error, bad.model) == ("failed", "`width` must be in [4, 1024]; got 1280. Record anew.", None)
    assert await bench.models.resolve(ModelRef("", "")) == (good.model, good.model.version)


async def test_a_bug_ends_one_fit_and_its_child_and_not_the_next(bench: Bench) -> None:
    async with bench.running() as fits:
        first, second = await begin(fits, "broken metrics"), await begin(fits)
        assert (await end(fits, first)).state == "failed"
        assert (await end(fits, second)).state == "succeeded"
        assert not psutil.pid_exists(bench.runs(first)[0])


async def test_fits_run_one_after_the_other_and_are_listed_newest_first(bench: Bench) -> None:
    async with bench.running() as fits:
        first, second = await begin(fits, "wait"), await begin(fits)
        await when(fits, first, lambda fit: fit.step == 2)
        assert [fit.id for fit in (await fits.list_fits(ListFitsRequest())).fits] == [second.id, first.id]
        assert (await fits.get_fit(GetFitRequest(second.id))).fit.state == "queued"
        await fits.cancel_fit(CancelFitRequest(first.id))
        assert (await end(fits, second)).state == "succeeded"


def test_models_that_are_activated_on_several_threads_at_once_leave_one_whole_record(bench: Bench) -> None:
    refs = []
    for name in "ab":
        (bench.root / name).mkdir()
        (bench.root / name / "card.json").write_text(json.dumps({"steps": 1, "name": name}))
        refs.append(bench.store.publish("default", bench.root / name))
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(bench.store.activate, refs * 50))
    assert bench.store.active_version("default") in {ref.version for ref in refs}


async def test_cancelling_ends_the_child_and_stays_final(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "wait")
        await when(fits, fit, lambda now: now.step == 2)
        assert (await fits.cancel_fit(CancelFitRequest(fit.id))).fit.state == "cancelled"
        assert not psutil.pid_exists(bench.runs(fit)[0])
        assert (await fits.cancel_fit(CancelFitRequest(fit.id))).fit.state == "cancelled"
        assert (await end(fits, fit)).state == "cancelled"


async def test_a_cancelled_fit_is_resumed_at_the_end_of_the_queue_and_only_then(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "wait")
        with pytest.raises(FailedPrecondition):
            await fits.resume_fit(ResumeFitRequest(fit.id))
        await when(fits, fit, lambda now: now.step == 2)
        await fits.cancel_fit(CancelFitRequest(fit.id))
        answers = [fits.resume_fit(ResumeFitRequest(fit.id)) for _ in range(2)]
        one, other = await asyncio.gather(*answers, return_exceptions=True)
        assert [type(one), type(other)].count(FailedPrecondition) == 1, "a fit is queued once"
        await when(fits, fit, lambda now: now.step == 4)
        assert len(bench.runs(fit)) == 2
        await fits.cancel_fit(CancelFitRequest(fit.id))


async def test_a_fit_that_has_succeeded_is_not_resumed(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits)
        assert (await end(fits, fit)).state == "succeeded"
        with pytest.raises(FailedPrecondition, match="this one is succeeded"):
            await fits.resume_fit(ResumeFitRequest(fit.id))
        assert len(bench.runs(fit)) == 1


async def test_cancelled_before_its_turn_a_fit_never_starts(bench: Bench) -> None:
    async with bench.running() as fits:
        first, second = await begin(fits, "wait"), await begin(fits)
        await when(fits, first, lambda fit: fit.step == 2)
        await fits.cancel_fit(CancelFitRequest(second.id))
        await fits.cancel_fit(CancelFitRequest(first.id))
        third = await begin(fits)
        await end(fits, third)
    assert not bench.folder(second).joinpath("runs.txt").exists()


async def test_cancelled_at_the_moment_its_child_is_started_a_fit_ends_too(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "wait")
        await when(fits, fit, lambda now: now.state == "running")  # the event before the process
        await fits.cancel_fit(CancelFitRequest(fit.id))
        second = await begin(fits)
        assert (await end(fits, second)).state == "succeeded"
        assert (await fits.get_fit(GetFitRequest(fit.id))).fit.state == "cancelled"


async def test_cancelled_while_its_model_is_loaded_a_fit_leaves_no_active_model(bench: Bench) -> None:
    loading, is_cancelled = threading.Event(), threading.Event()

    def load_slowly(folder: Path) -> str:
        loading.set()
        is_cancelled.wait()
        return load(folder)

    bench.models = ModelCache(bench.store, load_slowly, fit_command="freerein fit toy")
    async with bench.running() as fits:
        fit = await begin(fits)
        await asyncio.to_thread(loading.wait)
        cancelling = asyncio.create_task(fits.cancel_fit(CancelFitRequest(fit.id)))
        await when(fits, fit, lambda now: now.state == "cancelled")
        is_cancelled.set()
        assert (await cancelling).fit.state == "cancelled"
        assert (await fits.get_fit(GetFitRequest(fit.id))).fit.model is None
    assert not bench.store.active_version("default")


async def test_a_fit_is_read_while_calls_that_cancel_it_wait_for_its_end(bench: Bench) -> None:
    loading, may_end = threading.Event(), threading.Event()

    def load_slowly(folder: Path) -> str:
        loading.set()
        may_end.wait()
        return load(folder)

    bench.models = ModelCache(bench.store, load_slowly, fit_command="freerein fit toy")
    async with bench.running() as fits:
        fit = await begin(fits)
        await asyncio.to_thread(loading.wait)
        cancelling = [asyncio.create_task(fits.cancel_fit(CancelFitRequest(fit.id))) for _ in range(4)]
        reading = asyncio.create_task(fits.get_fit(GetFitRequest(fit.id)))  # begins after them
        await reading
        are_waiting = [not each.done() for each in cancelling]
        may_end.set()
        await asyncio.gather(*cancelling)
    assert are_waiting == [True] * 4


async def test_a_fit_whose_model_is_being_activated_is_no_longer_cancelled(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    activate, loop, cancels = bench.store.activate, asyncio.get_running_loop(), []
    async with bench.running() as fits:

        def cancel_and_activate(ref: ModelRef) -> None:
            cancels.append(asyncio.run_coroutine_threadsafe(fits.cancel_fit(CancelFitRequest(fit.id)), loop))
            activate(ref)

        monkeypatch.setattr(bench.store, "activate", cancel_and_activate)
        fit = await begin(fits)
        assert (await end(fits, fit)).state == "succeeded"
        assert (await asyncio.wrap_future(cancels[0])).fit.state == "succeeded"
        assert (await fits.get_fit(GetFitRequest(fit.id))).fit.model is not None
    assert bench.store.active_version("default")


async def test_after_a_drain_the_next_start_goes_on_with_what_had_not_ended(bench: Bench) -> None:
    async with bench.running() as fits:
        ended = await end(fits, await begin(fits))
        open_fit = await begin(fits, "wait")
        await when(fits, open_fit, lambda fit: fit.step == 2)
    assert not psutil.pid_exists(bench.runs(open_fit)[0])
    async with bench.running() as fits:
        kept = (await fits.list_fits(ListFitsRequest())).fits
        assert [fit.id for fit in kept] == [open_fit.id, ended.id]
        assert kept[1] == ended
        await when(fits, open_fit, lambda fit: fit.step == 4)
        await fits.cancel_fit(CancelFitRequest(open_fit.id))


async def test_a_full_disk_ends_no_runner_and_what_happened_is_recorded_when_there_is_room(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queue, "_DISK_S", 0.01)
    log, is_refused = logging.getLogger(queue.__name__), threading.Event()

    def notice(record: logging.LogRecord) -> bool:
        if "cannot be recorded" in record.getMessage():
            is_refused.set()
        return True

    monkeypatch.setattr(log, "filters", [notice])
    async with bench.running() as fits:
        first, second, third = await begin(fits, "wait"), await begin(fits, "permanent"), await begin(fits)
        events = bench.folder(second) / "events.jsonl"
        kept = events.rename(events.with_name("kept"))
        events.symlink_to("/dev/full")
        await fits.cancel_fit(CancelFitRequest(first.id))
        assert await asyncio.to_thread(is_refused.wait, 60)
        kept.replace(events)
        assert [(await end(fits, each)).state for each in (second, third)] == ["failed", "succeeded"]


async def test_a_fit_whose_folder_is_deleted_does_not_hold_up_the_next_one(bench: Bench) -> None:
    async with bench.running() as fits:
        first, second = await begin(fits, "wait"), await begin(fits)
        await when(fits, first, lambda now: now.step)
        child = int((bench.folder(first) / "runs.txt").read_text())
        shutil.rmtree(bench.folder(first))
        with suppress(ProcessLookupError):  # it is told to end as soon as the loss is noticed
            os.kill(child, signal.SIGKILL)
        assert (await end(fits, second)).state == "succeeded"
        assert [fit.id for fit in (await fits.list_fits(ListFitsRequest())).fits] == [second.id]


async def test_a_fit_is_deleted_once_it_has_ended_and_its_model_stays(bench: Bench) -> None:
    async with bench.running() as fits:
        ended = await end(fits, await begin(fits, key="mine"))
        running = await begin(fits, "wait")
        await when(fits, running, lambda now: now.step)
        with pytest.raises(FailedPrecondition, match="running"):
            await fits.delete_fit(DeleteFitRequest(running.id))
        await fits.delete_fit(DeleteFitRequest(ended.id))
        assert [fit.id for fit in (await fits.list_fits(ListFitsRequest())).fits] == [running.id]
        assert [path.name for path in (bench.root / "fits").iterdir() if path.is_dir()] == [running.id]
        with pytest.raises(NotFound):
            await fits.delete_fit(DeleteFitRequest(ended.id))
        assert (await begin(fits, "wait", key="mine")).state == "queued"  # the key is free again
        await fits.cancel_fit(CancelFitRequest(running.id))
        await fits.delete_fit(DeleteFitRequest(running.id))
    assert bench.store.active_version("default") == ended.model.version


async def test_an_idempotency_key_returns_the_fit_already_started_also_after_a_restart(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "wait", key="mine")
        assert (await begin(fits, "wait", key="mine")).id == fit.id
    async with bench.running() as fits:
        assert (await begin(fits, "wait", key="mine")).id == fit.id
        with pytest.raises(AlreadyExists):
            await begin(fits, "succeed", key="mine")
        assert (await begin(fits, "wait", key="yours")).id != fit.id


async def test_watchers_see_every_event_from_their_number_on_without_gaps(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits)
        events = [event async for event in fits.watch_fit(WatchFitRequest(fit.id))]
        assert [event.sequence for event in events] == list(range(len(events)))
        assert [events[0].fit.state, events[-1].fit.state] == ["queued", "succeeded"]
        resumed = [event async for event in fits.watch_fit(WatchFitRequest(fit.id, 2))]
        assert resumed == events[2:]


async def test_a_watcher_from_beyond_the_end_ends_with_the_fit(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits)
        assert [event async for event in fits.watch_fit(WatchFitRequest(fit.id, 2**63))] == []
        assert [event async for event in fits.watch_fit(WatchFitRequest(fit.id, 2**63))] == []


async def test_watchers_end_on_drain(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "wait")
        await when(fits, fit, lambda now: now.step == 2)
        watcher = asyncio.create_task(anext(fits.watch_fit(WatchFitRequest(fit.id, 100)), None))
        with suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(watcher), 0.01)
    assert await watcher is None


async def test_every_row_of_a_burst_is_an_event(bench: Bench) -> None:
    async with bench.running() as fits:
        fit = await begin(fits, "burst")
        events = [event.fit async for event in fits.watch_fit(WatchFitRequest(fit.id))]
    assert [now.step for now in events if now.state == "running"] == [0, 2, 3, 4, 5]
    assert [now.metrics["train_loss"] for now in events if now.step] == [0.5, 1 / 3, 1 / 4, 1 / 5, 1 / 5]


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        (StartFitRequest("../demos"), "dataset"),
        (StartFitRequest(""), "dataset"),
        (StartFitRequest("demos", "no/where"), "model_name"),
        (StartFitRequest("demos", idempotency_key="a b"), "idempotency_key"),
        (StartFitRequest("demos", config={"stepz": 1}), "config"),
    ],
)
async def test_a_wrong_request_is_refused_by_its_field(bench: Bench, request_: StartFitRequest, field: str) -> None:
    async with bench.running() as fits:
        with pytest.raises(InvalidInput) as error:
            await fits.start_fit(request_)
        assert error.value.field == field
        assert (await fits.list_fits(ListFitsRequest())).fits == ()


@pytest.mark.parametrize(("fit_id", "error"), [("0" * 32, NotFound), ("../x", InvalidInput), ("", InvalidInput)])
async def test_an_unknown_fit_is_not_found_and_a_path_is_no_id(
    bench: Bench, fit_id: str, error: type[Exception]
) -> None:
    async with bench.running() as fits:
        with pytest.raises(error):
            await fits.get_fit(GetFitRequest(fit_id))
        with pytest.raises(error):
            await fits.cancel_fit(CancelFitRequest(fit_id))
        with pytest.raises(error):
            await anext(fits.watch_fit(WatchFitRequest(fit_id)))


async def test_only_so_many_fits_may_wait(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue, "_MAX_WAITING", 1)
    async with bench.running() as fits:
        running = await begin(fits, "wait")
        await when(fits, running, lambda fit: fit.state == "running")
        await begin(fits)
        with pytest.raises(Overloaded):
            await begin(fits)


async def test_the_event_loop_runs_on_while_a_dataset_is_slow_to_open(bench: Bench) -> None:
    ticked = threading.Event()

    def resolve_slowly(dataset: str, config: Mapping[str, Any]) -> dict[str, Any]:
        assert ticked.wait(60), "the event loop is blocked"
        return resolve(dataset, config)

    async with bench.running(resolve_slowly) as fits:
        starting = asyncio.create_task(begin(fits, "wait"))
        await asyncio.sleep(0.05)
        ticked.set()
        assert (await starting).state == "queued"


def test_a_fit_is_on_disk_before_it_is_acknowledged(bench: Bench) -> None:
    async def scenario() -> Fit:
        async with bench.running() as fits:
            return await begin(fits, "wait")

    fit = asyncio.run(scenario())
    assert json.loads((bench.folder(fit) / "config.json").read_text()) == {
        "dataset": "demos",
        "model_name": "default",
        "config": {"behaviour": "wait", "steps": 5},
        "steps": 5,
    }
    assert os.fspath(bench.root) not in (bench.root / "fits" / fit.id / "events.jsonl").read_text()
