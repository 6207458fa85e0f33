"""`FitService`: fits of models, one at a time, each in a child process that survives crashes of itself and of ours."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from freerein.errors import NotFound
from freerein.fork_server import StartChild, spawn
from freerein.jobs.attempt import AttemptRunner
from freerein.jobs.queue import LocalQueue
from freerein.jobs.store import JobStore
from freerein.model_store import DEFAULT_NAME, ModelStore
from freerein.serving.health import Health
from freerein.serving.model_cache import ModelCache
from freerein.types import learning
from freerein.types.common import check_name

_POLL_S = 0.1
_THREADS = 4

T = TypeVar("T")
Resolve = Callable[[str, Mapping[str, Any]], dict[str, Any]]


class FitService:
    """The fits of one learned service. Files are read and written on threads, never on the event loop.

    Args:
        folder: Folder of the fits.
        module: Module of the child process; it writes the model to `model/`.
        arguments: Arguments of the child process after the fit's folder.
        store: Where models are published.
        models: Loads a model before it is activated.
        resolve: Returns the resolved configuration for the name of a dataset and a partial configuration; raises
            InvalidInput or NotFound for what cannot be fitted.
        health: Ends streams and stops the child on drain.
        start_child: Starts the child process.
        links: Folder of links to the fits by readable names; None for none.
    """

    def __init__(
        self,
        folder: Path,
        *,
        module: str,
        arguments: Sequence[str] = (),
        store: ModelStore,
        models: ModelCache[Any],
        resolve: Resolve,
        health: Health,
        start_child: StartChild = spawn,
        links: Path | None = None,
    ) -> None:
        self._jobs = JobStore(folder, noun="fit", links=links)
        runner = AttemptRunner(self._jobs, module=module, arguments=arguments, start_child=start_child)
        self._queue = LocalQueue(self._jobs, runner, publish=self._publish)
        self._store = store
        self._models = models
        self._resolve = resolve
        self._health = health
        self._threads = ThreadPoolExecutor(_THREADS, "fits")  # not the default one, which decodes requests
        self._changes = ThreadPoolExecutor(_THREADS, "fit-changes")  # of calls that wait for a child to end
        self._stopping: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Resumes the fits that had not ended when the service last stopped, oldest first."""
        self._loop = asyncio.get_running_loop()
        await self._in_thread(self._queue.start)
        self._stopping = asyncio.create_task(self._stop_on_drain())

    async def close(self) -> None:
        """Waits, on drain, until the child has saved and ended; the next start resumes its fit."""
        if self._stopping is not None:
            await self._stopping
        for threads in (self._threads, self._changes):
            threads.shutdown(wait=False, cancel_futures=True)

    async def start_fit(self, request: learning.StartFitRequest) -> learning.StartFitResponse:
        """Queues a fit, or returns the one that this idempotency key has started already.

        Raises:
            NotFound: There is no such dataset.
            InvalidInput: The configuration or a name is wrong.
            AlreadyExists: The idempotency key was used for another request.
            Overloaded: Too many fits are waiting.
        """
        check_name(request.dataset, field="dataset")
        if request.idempotency_key:
            check_name(request.idempotency_key, field="idempotency_key")
        check_name(request.model_name or DEFAULT_NAME, field="model_name")
        return learning.StartFitResponse(await self._in_thread(lambda: self._start(request)))

    async def get_fit(self, request: learning.GetFitRequest) -> learning.GetFitResponse:
        """Returns one fit. Raises NotFound when there is no such fit."""
        return learning.GetFitResponse(await self._in_thread(lambda: self._fit(request.id)))

    async def list_fits(self, request: learning.ListFitsRequest) -> learning.ListFitsResponse:
        """Returns one page of the fits, newest first."""

        def page() -> learning.ListFitsResponse:
            (ids, token), fits = self._jobs.page(request.page_size, request.page_token), []
            for fit_id in ids:
                with suppress(NotFound):  # deleted meanwhile
                    fits.append(self._fit(fit_id))
            return learning.ListFitsResponse(tuple(fits), token)

        return await self._in_thread(page)

    async def watch_fit(self, request: learning.WatchFitRequest) -> AsyncIterator[learning.WatchFitResponse]:
        """Yields the events of a fit from a sequence number on; ends with the fit, or on drain.

        Raises NotFound when there is no such fit.
        """

        async def pause(_is_new: bool) -> bool:
            return await self._health.await_or_drain(asyncio.sleep(_POLL_S, True)) is not None

        await self._in_thread(lambda: self._jobs.config(request.id))
        start, threads = request.from_sequence, self._threads
        async for sequence, fields in self._jobs.watch(request.id, from_sequence=start, pause=pause, threads=threads):
            yield learning.WatchFitResponse(sequence, learning.Fit(**fields))

    async def get_fit_metrics(self, request: learning.GetFitMetricsRequest) -> learning.GetFitMetricsResponse:
        """Returns the metrics of a fit from a step on, decimated. Raises NotFound when there is no such fit."""
        found = await self._in_thread(lambda: self._jobs.metrics(request))
        return learning.GetFitMetricsResponse(**vars(found))

    async def cancel_fit(self, request: learning.CancelFitRequest) -> learning.CancelFitResponse:
        """Cancels a fit that has not ended; its last checkpoint is kept. Raises NotFound when there is no such fit."""

        def cancel() -> learning.Fit:
            self._jobs.config(request.id)
            self._queue.cancel(request.id)
            return self._fit(request.id)

        return learning.CancelFitResponse(await self._in_thread(cancel, self._changes))

    async def resume_fit(self, request: learning.ResumeFitRequest) -> learning.ResumeFitResponse:
        """Queues a failed or cancelled fit again; it resumes from its last checkpoint.

        Raises:
            NotFound: There is no such fit.
            FailedPrecondition: The fit is neither failed nor cancelled.
            Overloaded: Too many fits are waiting.
        """

        def resume() -> learning.Fit:
            self._jobs.config(request.id)
            self._queue.resume(request.id)
            return self._fit(request.id)

        return learning.ResumeFitResponse(await self._in_thread(resume, self._changes))

    async def delete_fit(self, request: learning.DeleteFitRequest) -> learning.DeleteFitResponse:
        """Deletes a fit that has ended; the model that it made stays.

        Raises:
            NotFound: There is no such fit.
            FailedPrecondition: The fit has not ended.
            Overloaded: Its child has not ended yet.
        """
        await self._in_thread(lambda: self._queue.delete(request.id), self._changes)
        return learning.DeleteFitResponse()

    def _start(self, request: learning.StartFitRequest) -> learning.Fit:
        fit_id = self._jobs.find(vars(request))
        if fit_id is None:
            self._queue.check_room()
            config = self._resolve(request.dataset, request.config)
            asked = {"dataset": request.dataset, "model_name": request.model_name or DEFAULT_NAME}
            fit_id = self._jobs.create(vars(request), {**asked, "config": config, "steps": config["steps"]})
        fit = self._fit(fit_id)
        self._queue.put(fit_id)
        return fit

    def _fit(self, fit_id: str) -> learning.Fit:
        return learning.Fit(**self._jobs.fields(fit_id))

    def _publish(self, fit_id: str) -> Callable[[], None]:
        """Publishes the model of a fit; returns what activates it. Raises ServiceError when it cannot be loaded."""
        ref = self._store.publish(self._jobs.config(fit_id)["model_name"], self._jobs.folder(fit_id) / "model")
        asyncio.run_coroutine_threadsafe(self._models.resolve(ref), self._loop).result()

        def activate() -> None:
            self._jobs.set_model(fit_id, ref)
            self._store.activate(ref)

        return activate

    async def _stop_on_drain(self) -> None:
        await self._health.wait_for_drain()
        await asyncio.to_thread(self._queue.close)

    def _in_thread(self, call: Callable[[], T], threads: Executor | None = None) -> "asyncio.Future[T]":
        return asyncio.get_running_loop().run_in_executor(threads or self._threads, call)
