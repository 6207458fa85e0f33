"""Models in memory: the core of `ModelService`, and the source of a learned core's models."""

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from freerein.errors import FailedPrecondition, InvalidInput, NotFound, quoted
from freerein.model_store import DEFAULT_NAME, ModelStore, model_card
from freerein.types.common import ModelRef, check_name
from freerein.types.learning import (
    ActivateModelRequest,
    ActivateModelResponse,
    DeleteModelRequest,
    DeleteModelResponse,
    ListModelsRequest,
    ListModelsResponse,
    Model,
)

_log = logging.getLogger(__name__)

M = TypeVar("M")
T = TypeVar("T")

_MAX_INACTIVE = 4
_MAX_NAMED = 8


class ModelCache(Generic[M]):
    """LRU cache of one learned service's models. Active models are loaded at start and never evicted.

    Files are read on threads, never on the event loop. Which version is active is read for each call that names none.

    Args:
        store: The models on disk.
        load: Loads and warms up the model of a folder. Called off the event loop.
        fit_command: The command that fits a model, for the error when there is none.
        check_unused: Raises FailedPrecondition where a version must not be deleted, for a fit or run needs it.
    """

    def __init__(
        self,
        store: ModelStore,
        load: Callable[[Path], M],
        *,
        fit_command: str,
        check_unused: Callable[[ModelRef], None] = lambda _: None,
    ) -> None:
        self._store = store
        self._load = load
        self._fit_command = fit_command
        self._check_unused = check_unused
        self._loaded: OrderedDict[ModelRef, M] = OrderedDict()
        self._loading = asyncio.Lock()
        self._loads: dict[ModelRef, asyncio.Task[M]] = {}
        self._started = False
        self._reader = ThreadPoolExecutor(1, "models")  # not one that decodes: a disk that hangs ends no decoding

    async def start(self) -> None:
        """Loads the active version of every model. Raises FailedPrecondition when files are missing or changed.

        A model that this version of freerein cannot load is logged, and answers with the same error when it is named:
        the others must be served, and a fit makes it anew.
        """
        for name in await self._read(self._store.names):
            if version := await self._read(partial(self._store.active_version, name)):
                try:
                    await self._get(ModelRef(name, version))
                except NotFound:
                    raise FailedPrecondition(
                        f"The active version of model {name}, {version}, must be in the store; its folder is gone.",
                        field="model",
                        hint=f"Restore it, or delete {name}/active.json in the folder of models.",
                    ) from None
                except InvalidInput as error:
                    _log.error("a model cannot be loaded: %s", error.detail, extra={"model": f"{name} {version}"})
        self._started = True

    def not_ready(self) -> str:
        """Returns why models cannot answer yet, empty when they can. A service without models is ready."""
        return "" if self._started else "Its models are being loaded."

    async def resolve(self, ref: ModelRef) -> tuple[ModelRef, M]:
        """Returns the model that a request names, and its full reference.

        Raises FailedPrecondition when no version of that name is active, NotFound when the model does not exist.
        """
        name = check_name(ref.name or DEFAULT_NAME, field="model.name")
        version = ref.version or await self._read(partial(self._store.active_version, name))
        if not version:
            raise FailedPrecondition(
                f"The request needs an active model; no version of {quoted(name)} is active.",
                field="model",
                hint=await self._read(self._hint),
            )
        full_ref = ModelRef(name, version)
        return full_ref, await self._get(full_ref)

    async def publish(self, name: str, folder: Path) -> ModelRef:
        """Publishes a folder of files as a version, loads it and makes it the active one.

        Args:
            name: The model's name.
            folder: The files, among them `card.json`; moved or removed.
        """
        ref = await asyncio.to_thread(self._store.publish, name, folder)
        await self._get(ref)
        await asyncio.to_thread(self._store.activate, ref)
        return ref

    async def list_models(self, _request: ListModelsRequest) -> ListModelsResponse:
        """Returns every version of every model."""
        return ListModelsResponse(await asyncio.to_thread(self._store.models))

    async def activate_model(self, request: ActivateModelRequest) -> ActivateModelResponse:
        """Loads a version, then makes it the active one, between two batches; raises as `ModelStore.activate`."""
        name = check_name(request.name or DEFAULT_NAME, field="name")
        ref = ModelRef(name, check_name(request.version, field="version"))

        def activate() -> Model:
            folder = self._store.folder(ref)  # checks the files again
            self._store.activate(ref, expected_current=request.expected_current)
            return Model(ref, True, model_card(folder), self._store.published_ns(folder))

        await self._get(ref)
        async with self._loading:  # nor is it deleted meanwhile
            return ActivateModelResponse(await asyncio.to_thread(activate))

    async def delete_model(self, request: DeleteModelRequest) -> DeleteModelResponse:
        """Deletes a version, or all of a name; requests that have it already are answered.

        Raises:
            InvalidInput: The name is missing, or malformed.
            NotFound: There is none.
            FailedPrecondition: It came with freerein, is active, or a fit or run that has not ended names it.
        """

        def delete() -> tuple[ModelRef, ...]:
            refs = self._store.published(request.name, request.version)
            for ref in refs:
                self._check_unused(ref)
            self._store.delete(refs, even_active=request.even_active)
            return refs

        async with self._loading:  # no model is read meanwhile
            refs = await asyncio.to_thread(delete)
            for ref in refs:
                self._loaded.pop(ref, None)
        return DeleteModelResponse(refs)

    async def _get(self, ref: ModelRef) -> M:
        """Returns a model. It is loaded once for all callers, also where the first of them gives up meanwhile."""
        if ref in self._loaded:
            self._loaded.move_to_end(ref)
            return self._loaded[ref]
        if ref not in self._loads:
            self._loads[ref] = asyncio.create_task(self._load_into_memory(ref))
            self._loads[ref].add_done_callback(lambda done: self._end_load(ref, done))
        return await asyncio.shield(self._loads[ref])

    async def _load_into_memory(self, ref: ModelRef) -> M:
        async with self._loading:
            self._loaded[ref] = model = await asyncio.to_thread(lambda: self._load(self._store.folder(ref)))
            await self._evict()
            return model

    def _end_load(self, ref: ModelRef, done: "asyncio.Task[M]") -> None:
        del self._loads[ref]
        if not done.cancelled():
            done.exception()  # callers that still wait have it; there may be none

    def _read(self, call: Callable[[], T]) -> "asyncio.Future[T]":
        """Returns what a call returns that reads the store; not on the event loop, which a disk may hold up."""
        return asyncio.get_running_loop().run_in_executor(self._reader, call)

    def _hint(self) -> str:
        """Returns how to name an active model, where there are some, or to fit one."""
        active = [name for name in self._store.names() if self._store.active_version(name)]
        named = f"Name an active one: {', '.join(active[:_MAX_NAMED])}. Or fit" if active else "Fit"
        return f"{named} one: {self._fit_command}"

    async def _evict(self) -> None:
        """Drops the least recently used inactive models above the limit; active models always stay in memory."""
        loaded = tuple(self._loaded)
        inactive = await self._read(lambda: [ref for ref in loaded if not self._is_active(ref)])
        for ref in inactive[:-_MAX_INACTIVE]:
            del self._loaded[ref]

    def _is_active(self, ref: ModelRef) -> bool:
        try:
            return self._store.active_version(ref.name) == ref.version
        except FailedPrecondition:  # the active.json of another model is damaged; requests for that model report it
            return False
