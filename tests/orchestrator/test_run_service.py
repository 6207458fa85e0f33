"""The core of the orchestrator over a database in a file: what it says of a run is so, whatever happens in between."""

import asyncio
import errno
import shutil
import threading
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, Overloaded, Unavailable
from freerein.jobs.attempt import AttemptStopped, StopRequest
from freerein.jobs.retry import AttemptResult, Pause
from freerein.jobs.store import JobStore
from freerein.serving.health import Health
from freerein.types.jobs import JobState
from freerein.types.orchestrator import (
    CancelRunRequest,
    DeleteRunRequest,
    GetRunRequest,
    ListRunsRequest,
    ResumeRunRequest,
    Run,
    StartRunRequest,
    WatchRunRequest,
)
from freerein_orchestrator.runs import service
from freerein_orchestrator.runs.dbos_queue import DbosQueue
from freerein_orchestrator.runs.service import Resolved, RunService

REFUSED = AttemptResult("failed", error="The dataset must hold two skills; it holds one.")


class Orchestrator:
    """A core, its database, and a worker whose attempts end as they are told to.

    Attributes:
        between: Called after all states were read from the database, and before anything is made of them.
        full: Whether the disk refuses the ends of runs.
        away: Whether the database refuses to queue a run, or to queue it again.
        needed: A run that another builds on.
        attempts: How the next attempts end; then they wait to be interrupted.
        is_attempted: Set when an attempt begins.
    """

    def __init__(self, data_dir: Path) -> None:
        self.between: Callable[[], object] = bool
        self.full = self.away = False
        self.attempts: list[AttemptResult] = []
        self.is_attempted = threading.Event()
        self.known = True
        self.needed = ""
        self.store = JobStore(data_dir, noun="run")
        self.queue = InterferedQueue(self, data_dir)
        self.runs = RunService(
            self.store, self.queue, resolve=self._resolve, health=Health(), check_unused=self._check_unused
        )

    async def start(self, key: str = "") -> str:
        return (await self.runs.start_run(StartRunRequest("ppo", {}, key))).run.id

    async def get(self, run_id: str) -> Run:
        return (await self.runs.get_run(GetRunRequest(run_id))).run

    async def until(self, run_id: str, state: JobState) -> None:
        """Returns when a run is in a state."""
        while (await self.get(run_id)).state != state:  # noqa: ASYNC110 -- only a watcher is told
            await asyncio.sleep(0.01)

    async def watch(self, run_id: str) -> list[JobState]:
        return [event.run.state async for event in self.runs.watch_run(WatchRunRequest(run_id))]

    def attempt(self, run_id: str, stop: Callable[[], StopRequest], _pause: Pause) -> AttemptResult:
        self.is_attempted.set()
        while not self.attempts:
            if stop():
                raise AttemptStopped
        self.store.record(run_id, "running")
        return self.attempts.pop(0)

    def _check_unused(self, run_id: str) -> None:
        if run_id == self.needed:
            raise FailedPrecondition("A run must not be in use.")

    def _resolve(self, _kind: str, config: Any) -> Resolved:
        if not self.known:
            raise InvalidInput("A run to build on must be there.", field="config")
        return Resolved(dict(config), steps=1)


class FullStore(JobStore):
    """Jobs on a disk that is full when told to be."""

    def __init__(self, test: Orchestrator, folder: Path) -> None:
        super().__init__(folder, noun="run")
        self._test = test

    def record(self, job_id: str, state: JobState, **changes: Any) -> None:
        if self._test.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().record(job_id, state, **changes)


class InterferedQueue(DbosQueue):
    """A real database, with something happening at the worst moment."""

    def __init__(self, test: Orchestrator, folder: Path) -> None:
        super().__init__(folder, store=FullStore(test, folder), executor_id="worker", attempt=test.attempt)
        self._test = test

    def states(self, run_ids: Sequence[str]) -> dict[str, JobState]:
        states = super().states(run_ids)
        self._test.between()
        return states

    def resume(self, run_id: str) -> None:
        if self._test.away:
            raise Unavailable("The database of the runs must be within reach.")
        super().resume(run_id)

    def start(self, run_id: str) -> None:
        if self._test.away:
            raise Unavailable("The database of the runs must be within reach.")
        super().start(run_id)


@pytest_asyncio.fixture
async def orchestrator(tmp_path: Path) -> AsyncIterator[Orchestrator]:
    orchestrator = Orchestrator(tmp_path)
    await orchestrator.runs.start()
    yield orchestrator
    await orchestrator.runs.close()


async def test_a_run_that_is_resumed_while_a_list_is_made_is_not_noted_as_ended(orchestrator):
    loop, run_id = asyncio.get_running_loop(), await orchestrator.start()
    orchestrator.queue.cancel(run_id)  # by another worker that then died: nobody has noted it

    def resume() -> None:
        orchestrator.between = bool
        asyncio.run_coroutine_threadsafe(orchestrator.runs.resume_run(ResumeRunRequest(run_id)), loop).result()

    orchestrator.between = resume
    await orchestrator.runs.list_runs(ListRunsRequest())
    orchestrator.attempts.append(AttemptResult("succeeded"))
    await orchestrator.until(run_id, "succeeded")
    assert await orchestrator.watch(run_id) == ["queued", "cancelled", "queued", "running", "succeeded"]


async def test_a_run_that_could_not_be_resumed_still_says_why_it_failed(orchestrator):
    orchestrator.attempts.append(REFUSED)
    run_id = await orchestrator.start()
    assert (await orchestrator.watch(run_id))[-1] == "failed"
    orchestrator.away = True
    with pytest.raises(Unavailable):
        await orchestrator.runs.resume_run(ResumeRunRequest(run_id))
    run = await orchestrator.get(run_id)
    assert (run.state, run.error) == ("failed", REFUSED.error)


@pytest.mark.fault("O5")
async def test_an_end_that_a_full_disk_kept_from_being_noted_is_an_end_and_a_silent_watcher_hears_of_it(orchestrator):
    orchestrator.full = True
    orchestrator.attempts.append(AttemptResult("succeeded"))
    run_id = await orchestrator.start()
    assert await asyncio.wait_for(orchestrator.watch(run_id), 60) == ["queued", "running", "succeeded"]


@pytest.mark.fault("O9")
async def test_a_known_key_is_its_run_whatever_may_no_longer_be_started(orchestrator, monkeypatch):
    monkeypatch.setattr(service, "_MAX_WAITING", 1)
    await orchestrator.start()
    while orchestrator.queue.count_queued(limit=2):  # until it is being made
        pass
    run_id = await orchestrator.start("key")
    with pytest.raises(Overloaded):
        await orchestrator.start("other")
    orchestrator.known = False
    assert await orchestrator.start("key") == run_id
    with pytest.raises(AlreadyExists):
        await orchestrator.runs.start_run(StartRunRequest("ppo", {"seed": 1}, "key"))
    with pytest.raises(InvalidInput):
        await orchestrator.start("other")


@pytest.mark.fault("O9")
async def test_a_run_that_could_not_be_queued_leaves_nothing_but_one_with_a_key_is_queued_by_the_next_call(
    orchestrator,
):
    orchestrator.away = True
    for key in ("", "key"):
        with pytest.raises(Unavailable):
            await orchestrator.start(key)
    (kept,) = orchestrator.store.unfinished()
    orchestrator.away = False
    assert await orchestrator.start("key") == kept


async def test_a_run_that_a_kill_kept_from_the_database_is_queued_at_the_next_start(tmp_path):
    orchestrator = Orchestrator(tmp_path)
    config = {"kind": "ppo", "config": {}, "steps": 1}
    kept, begun = (orchestrator.store.create(vars(StartRunRequest("ppo", {}, key)), config) for key in ("key", ""))
    orchestrator.store.record(begun, "running")  # with another database
    await orchestrator.runs.start()
    assert [run.id for run in (await orchestrator.runs.list_runs(ListRunsRequest())).runs] == [kept]
    assert await orchestrator.start("key") == kept
    await orchestrator.runs.close()


async def test_the_key_of_a_run_that_was_deleted_starts_nothing(orchestrator):
    orchestrator.attempts.append(AttemptResult("succeeded"))
    run_id = await orchestrator.start("key")
    assert (await orchestrator.watch(run_id))[-1] == "succeeded"
    while orchestrator.queue.status(run_id).state == "running":  # noqa: ASYNC110 -- nobody is told
        await asyncio.sleep(0.01)
    shutil.rmtree(orchestrator.store.folder(run_id))
    with pytest.raises(AlreadyExists):
        await orchestrator.start("key")
    assert not orchestrator.store.exists(run_id)
    with pytest.raises(NotFound):
        await orchestrator.runs.delete_run(DeleteRunRequest(run_id))
    assert await orchestrator.start("key") == run_id  # the database has forgotten it


async def test_a_run_is_deleted_once_it_has_ended_unless_another_builds_on_it(orchestrator):
    orchestrator.attempts.append(REFUSED)
    run_id, queued = await orchestrator.start("key"), await orchestrator.start()
    assert (await orchestrator.watch(run_id))[-1] == "failed"
    with pytest.raises(FailedPrecondition, match="must have ended"):
        await orchestrator.runs.delete_run(DeleteRunRequest(queued))
    orchestrator.needed = run_id
    with pytest.raises(FailedPrecondition, match="in use"):
        await orchestrator.runs.delete_run(DeleteRunRequest(run_id))
    orchestrator.needed = ""
    await orchestrator.runs.delete_run(DeleteRunRequest(run_id))
    assert [run.id for run in (await orchestrator.runs.list_runs(ListRunsRequest())).runs] == [queued]
    with pytest.raises(NotFound):
        await orchestrator.runs.delete_run(DeleteRunRequest(run_id))
    assert (await orchestrator.get(await orchestrator.start("key"))).state != "failed"  # the key is free again


async def test_a_run_that_is_attempted_has_not_ended_whatever_was_recorded_last(orchestrator):
    run_id = await orchestrator.start()
    orchestrator.queue.cancel(run_id)
    await orchestrator.until(run_id, "cancelled")
    orchestrator.queue.resume(run_id)  # by a worker that gave up on the database too soon to record it
    orchestrator.attempts.append(AttemptResult("succeeded"))
    await orchestrator.until(run_id, "succeeded")
    assert (await orchestrator.watch(run_id))[-4:] == ["cancelled", "queued", "running", "succeeded"]


async def test_a_run_whose_folder_is_deleted_in_part_is_left_out_of_the_list(orchestrator):
    gone, left = await orchestrator.start(), await orchestrator.start()
    (orchestrator.store.folder(gone) / "events.jsonl").unlink()
    assert [run.id for run in (await orchestrator.runs.list_runs(ListRunsRequest())).runs] == [left]
    with pytest.raises(NotFound):
        await orchestrator.get(gone)


async def test_a_run_that_has_just_succeeded_can_no_longer_be_cancelled(orchestrator):
    run_id = await orchestrator.start()
    assert await asyncio.to_thread(orchestrator.is_attempted.wait, 60)
    orchestrator.store.record(run_id, "succeeded")  # as its worker does, just before the database hears of it
    assert (await orchestrator.runs.cancel_run(CancelRunRequest(run_id))).run.state == "succeeded"
    with pytest.raises(FailedPrecondition):
        await orchestrator.runs.resume_run(ResumeRunRequest(run_id))
    orchestrator.attempts.append(AttemptResult("succeeded"))
    while (state := orchestrator.queue.status(run_id).state) == "running":  # noqa: ASYNC110 -- nobody is told
        await asyncio.sleep(0.01)
    assert state == "succeeded"


async def test_runs_are_listed_in_pages_newest_first(orchestrator):
    ids = [await orchestrator.start() for _ in range(3)]
    first = await orchestrator.runs.list_runs(ListRunsRequest(page_size=2))
    second = await orchestrator.runs.list_runs(ListRunsRequest(page_size=2, page_token=first.next_page_token))
    assert [run.id for run in first.runs + second.runs] == ids[::-1]
    assert second.next_page_token == ""
