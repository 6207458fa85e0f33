"""The common parts of services with learned models: settings, models, one batcher, fits."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Self, TypeVar

from google.protobuf.descriptor import ServiceDescriptor
from pydantic import Field, model_validator

from freerein.api.learning.v1 import learning_pb2
from freerein.errors import quoted
from freerein.fork_server import StartChild, spawn
from freerein.jobs.in_use import check_unused, names_model
from freerein.jobs.names import LINKS
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.fits import FitService
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.methods import methods_of
from freerein.serving.model_cache import ModelCache
from freerein.serving.rest.websocket import OpenSession
from freerein.serving.settings import ServiceSettings
from freerein.types.common import ModelRef

Model = TypeVar("Model")
_NO_FOLDER = "none"


class LearnedSettings(ServiceSettings):
    """Settings of a learned service.

    Attributes:
        device: Device of the models: `auto`, `cpu` or `cuda:N`.
        train_threads: Default number of threads of a fit; small networks are as fast on one as on two.
        shipped_dir: Folder of the shipped models, `none` for none; unset for `models/` of the clone.
    """

    device: str = Field(default="auto", pattern=r"^(auto|cpu|cuda:\d+)$")
    train_threads: int = Field(default=1, ge=1, le=256)
    shipped_dir: Path | None = None

    @model_validator(mode="after")
    def _check_shipped_dir(self) -> Self:
        if self.shipped_dir and self.shipped_dir.name != _NO_FOLDER and not self.shipped_dir.is_dir():
            found = quoted(str(self.shipped_dir))
            raise ValueError(f"FREEREIN_SHIPPED_DIR must be a folder, or `{_NO_FOLDER}`; there is no folder {found}")
        return self


def open_store(name: str, settings: LearnedSettings) -> ModelStore:
    """Returns the models of a service: those in the data directory and those shipped."""
    return ModelStore(settings.data_dir / "models" / name, shipped=(settings.shipped_dir or CLONE_MODELS) / name)


def learned_service(
    name: str,
    contract: ServiceDescriptor,
    make_cores: Callable[[ModelCache[Model]], Sequence[object]],
    *,
    settings: LearnedSettings,
    health: Health,
    batcher: Batcher[Any, Any],
    load: Callable[[Path], Model],
    resolve: Callable[..., dict[str, Any]],
    config_schema: Callable[[], dict[str, Any]] = dict,
    make_websocket: Callable[[ModelCache[Model]], OpenSession] | None = None,
    fit_arguments: Sequence[str] = (),
    fit_hint: str = "",
    start_child: StartChild = spawn,
) -> Service:
    """Returns a learned service: the methods of its cores, `FitService` and `ModelService`.

    `start_child` starts `freerein_<name>.fit` for a fit. `resolve` is called with the data directory, the dataset, the
    configuration and `threads`; see `FitService`. `config_schema` returns the JSON schema of the configuration.
    `make_websocket` makes what opens the connections of a WebSocket, where there is one.
    """
    settings.make_data_dir()
    store = open_store(name, settings)
    models = _cached(store, load, fit_command=f"freerein fit {name} DATASET{fit_hint}", data_dir=settings.data_dir)
    fits = FitService(
        settings.data_dir / "fits" / name,
        module=f"freerein_{name}.fit_child",
        arguments=(str(settings.data_dir), settings.device, *fit_arguments),
        store=store,
        models=models,
        resolve=lambda dataset, config: resolve(settings.data_dir, dataset, config, threads=settings.train_threads),
        health=health,
        start_child=start_child,
        links=settings.data_dir / LINKS,
    )

    async def start() -> None:
        await models.start()
        await fits.start()

    async def close() -> None:
        await fits.close()
        batcher.close()

    contracts = (contract, *(learning_pb2.DESCRIPTOR.services_by_name[each] for each in ("FitService", "ModelService")))
    cores = (*make_cores(models), fits, models)
    return Service(
        name=name,
        methods=tuple(method for each in contracts for method in methods_of(each, *cores)),
        start=start,
        close=close,
        not_ready=lambda: models.not_ready() or batcher.not_ready(),
        hangs=batcher.hangs,
        open_websocket=make_websocket(models) if make_websocket else None,
        jobs={"fit": settings.data_dir / "fits" / name},
        configs=lambda: {"StartFitRequest": config_schema()},
    )


def _cached(store: ModelStore, load: Callable[[Path], Model], *, fit_command: str, data_dir: Path) -> ModelCache[Model]:
    """Returns the cache of a store, whose models stay while a fit or run of the data directory names them."""

    def check(ref: ModelRef) -> None:
        check_unused(data_dir, f"Model {ref.name} {ref.version}", names_model(ref))

    return ModelCache(store, load, fit_command=fit_command, check_unused=check)
