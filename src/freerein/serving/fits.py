"""Fits: trainings of models, one at a time, each in a child process that may die at any moment and is started again.

The child is `python -m <module> <folder> <argument>...`. It reads `config.json` there, writes `metrics.jsonl` and its
checkpoints, resumes from these, and ends with exit code 0 and the model in `model/`, or with 2 and one line on stderr
when trying again cannot help. It ends when its standard input closes: then its parent is gone.
"""

import asyncio
import json
import logging
import math
import sys
import uuid
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from freerein.errors import AlreadyExists, Overloaded, ServiceError
from freerein.serving.fit_records import FitRecords
from freerein.serving.health import Health
from freerein.serving.model_cache import ModelCache
from freerein.serving.model_store import DEFAULT_NAME, ModelStore
from freerein.types.common import check_name
from freerein.types.learning import (
    CancelFitRequest,
    CancelFitResponse,
    Fit,
    GetFitRequest,
    GetFitResponse,
    ListFitsRequest,
    ListFitsResponse,
    StartFitRequest,
    StartFitResponse,
    WatchFitRequest,
    WatchFitResponse,
)

_log = logging.getLogger(__name__)
_POLL_S = 0.2
_SAVE_S = 5.0
_DISK_S = 1.0
_CRASHES = 3
_WAITING = 64
HOPELESS = 2
"""Exit code of a child that cannot succeed however often it is started."""

Resolve = Callable[[str, Mapping[str, Any]], dict[str, Any]]


class Fits:
    """The fits of one learned service: the core of `FitService`.

    Args:
        records: Where they are kept.
        module: The child's module, such as `freerein_segmentation.fit`.
        arguments: What its command line holds beside its folder.
        store: Where finished models go.
        models: What answers with them: one that cannot be loaded is never activated.
        resolve: Returns the whole configuration for a dataset's name and a partial one; raises InvalidInput or
            NotFound when there can be no such fit.
        health: Ends the streams of WatchFit on drain.
    """

    def __init__(
        self,
        records: FitRecords,
        *,
        module: str,
        arguments: Sequence[str] = (),
        store: ModelStore,
        models: ModelCache[Any],
        resolve: Resolve,
        health: Health,
    ) -> None:
        self._records = records
        self._command = (sys.executable, "-m", module)
        self._arguments = arguments
        self._store = store
        self._models = models
        self._resolve = resolve
        self._health = health
        self._queue: asyncio.Queue[str] = asyncio.Queue()
        self._child: asyncio.subprocess.Process | None = None
        self._running = ""
        self._stopping: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Goes on with the fits that had not ended when the service last stopped, oldest first."""
        for fit in self._records.all():
            if not fit.ended:
                self._queue.put_nowait(fit.id)
        self._stopping = asyncio.create_task(self._stop_on_drain(asyncio.create_task(self._run_all())))

    async def close(self) -> None:
        """Waits, on drain, for the end of the child, which saves first; the next start goes on with its fit."""
        if self._stopping is not None:
            await self._stopping

    async def start_fit(self, request: StartFitRequest) -> StartFitResponse:
        """Queues a fit.

        Raises:
            NotFound: There is no such dataset.
            InvalidInput: The configuration or a name is wrong.
            AlreadyExists: The idempotency key belongs to another request.
            Overloaded: Too many fits wait already.
        """
        check_name(request.dataset, field="dataset")
        if request.idempotency_key:
            check_name(request.idempotency_key, field="idempotency_key")
        name = check_name(request.model_name or DEFAULT_NAME, field="model_name")
        if known := self._records.started_by(request.idempotency_key):
            if known[0] != request:
                raise AlreadyExists(
                    "An idempotency key belongs to one request; this one was used for another.",
                    field="idempotency_key",
                    hint="Choose a new key for a new fit.",
                )
            return StartFitResponse(known[1])
        if self._queue.qsize() >= _WAITING:
            raise Overloaded(f"At most {_WAITING} fits may wait; they do.", hint="Cancel one, or wait for one to end.")
        config = self._resolve(request.dataset, request.config)
        fit = Fit(uuid.uuid4().hex, "queued", request.dataset, name, config, steps=config["steps"])
        await self._records.add(fit, request)
        self._queue.put_nowait(fit.id)
        return StartFitResponse(fit)

    async def get_fit(self, request: GetFitRequest) -> GetFitResponse:
        """Returns one fit. Raises NotFound when there is none of that id."""
        return GetFitResponse(self._records.fit(request.id))

    async def list_fits(self, _request: ListFitsRequest) -> ListFitsResponse:
        """Returns all fits, newest first."""
        return ListFitsResponse(self._records.all()[::-1])

    async def watch_fit(self, request: WatchFitRequest) -> AsyncIterator[WatchFitResponse]:
        """Yields a fit's events from a sequence number on; ends when the fit has ended, or on drain.

        Raises:
            NotFound: There is none of that id.
        """
        events, sequence = self._records.events(request.id), request.from_sequence
        while True:
            for number in range(sequence, len(events)):
                yield WatchFitResponse(number, events[number])
            sequence = max(sequence, len(events))
            if events[-1].ended:
                return
            if await self._health.await_or_drain(self._records.wait_beyond(request.id, sequence)) is None:
                return

    async def cancel_fit(self, request: CancelFitRequest) -> CancelFitResponse:
        """Ends a fit that has not ended; its last checkpoint stays. Raises NotFound when there is none of that id."""
        fit = self._records.fit(request.id)
        if not fit.ended:
            fit = replace(fit, state="cancelled")
            await self._records.change(fit)
            if self._running == fit.id:
                await asyncio.shield(self._stop_child())  # also where the caller does not wait so long
        return CancelFitResponse(fit)

    async def _stop_on_drain(self, runner: "asyncio.Task[None]") -> None:
        await self._health.wait_for_drain()
        runner.cancel()
        await asyncio.gather(runner, return_exceptions=True)
        await self._stop_child()

    async def _run_all(self) -> None:
        while True:
            fit_id = await self._queue.get()
            try:
                await self._run(fit_id)
            except OSError as error:
                await self._give_up(fit_id, f"The disk failed: {error.strerror}.")
            except Exception:  # one fit's bug must not end all fits
                await self._give_up(fit_id, "A bug of ours; the log says more.")

    async def _run(self, fit_id: str) -> None:
        """Starts the child, again after each crash, until the fit has ended."""
        crashes = 0
        while not self._records.fit(fit_id).ended:
            step = self._records.fit(fit_id).step
            self._running = fit_id
            code, complaint = await self._run_child(fit_id)
            self._running = ""
            crashes = crashes + 1 if self._records.fit(fit_id).step == step else 0
            if self._records.fit(fit_id).ended:
                return
            if code == 0:
                await self._succeed(fit_id)
            elif code == HOPELESS:
                await self._change(fit_id, state="failed", error=complaint)
            elif crashes >= _CRASHES:
                reason = f"Its process ended with code {code}, {crashes} times without progress."
                await self._change(fit_id, state="failed", error=reason)

    async def _run_child(self, fit_id: str) -> tuple[int, str]:
        work = self._records.work(fit_id)
        await self._change(fit_id, state="running")
        with (work / "log.txt").open("ab") as log:
            self._child = await asyncio.create_subprocess_exec(
                *self._command, str(work), *self._arguments, stdin=asyncio.subprocess.PIPE, stdout=log, stderr=log
            )
        if self._records.fit(fit_id).ended:  # cancelled while the process was being started
            await self._stop_child()
        ended = asyncio.ensure_future(self._child.wait())
        while not ended.done():
            await asyncio.wait({ended}, timeout=_POLL_S)
            await self._note_progress(fit_id, work / "metrics.jsonl")
        return ended.result(), _last_line(work / "log.txt")

    async def _note_progress(self, fit_id: str, path: Path) -> None:
        fit, line = self._records.fit(fit_id), _last_line(path)
        if fit.ended or not line:
            return
        metrics = json.loads(line)
        step = metrics.pop("step")
        if step != fit.step:
            finite = {name: value for name, value in metrics.items() if math.isfinite(value)}
            with suppress(OSError):  # where the disk is full, the next look records it
                await self._records.change(replace(fit, step=step, metrics=finite))

    async def _succeed(self, fit_id: str) -> None:
        name, folder = self._records.fit(fit_id).model_name, self._records.work(fit_id) / "model"
        ref = await asyncio.to_thread(self._store.publish, name, folder)
        try:
            await self._models.resolve(ref)
        except ServiceError as error:
            await self._change(fit_id, state="failed", error=f"{error.detail} {error.hint}")
            return
        if not self._records.fit(fit_id).ended:  # it may have been cancelled meanwhile
            self._store.activate(ref)
            await self._change(fit_id, state="succeeded", model=ref)

    async def _give_up(self, fit_id: str, reason: str) -> None:
        _log.exception("a fit failed", extra={"fit": fit_id})
        await self._stop_child()
        await self._change(fit_id, state="failed", error=reason)

    async def _change(self, fit_id: str, **changes: Any) -> None:
        """Records a change of a fit that has not ended, as soon as the disk takes it."""
        while not self._records.fit(fit_id).ended:
            try:
                await self._records.change(replace(self._records.fit(fit_id), **changes))
                return
            except OSError:
                _log.exception("a fit's change cannot be recorded yet", extra={"fit": fit_id})
                await asyncio.sleep(_DISK_S)

    async def _stop_child(self) -> None:
        if self._child is None or self._child.returncode is not None:
            return
        self._child.terminate()
        try:
            await asyncio.wait_for(self._child.wait(), _SAVE_S)
        except TimeoutError:
            self._child.kill()
            await self._child.wait()


def _last_line(path: Path) -> str:
    """Returns the last whole line of a file that another process appends to, empty when there is none."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 4096))
        lines = file.read().rpartition(b"\n")[0].splitlines()
    return lines[-1].decode(errors="replace") if lines else ""
