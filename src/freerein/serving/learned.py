"""What services with learned models have in common: settings, model store, fits."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from google.protobuf.descriptor import ServiceDescriptor
from pydantic import Field

from freerein.api.learning.v1 import learning_pb2
from freerein.serving.batcher import Batcher
from freerein.serving.fits import FitService
from freerein.serving.lifecycle import Service
from freerein.serving.methods import methods_of
from freerein.serving.model_cache import ModelCache
from freerein.serving.model_store import CLONE_MODELS, ModelStore
from freerein.serving.settings import ServiceSettings

M = TypeVar("M")


class LearnedSettings(ServiceSettings):
    """Settings of a learned service.

    Attributes:
        device: Device of the models: `auto`, `cpu` or `cuda:N`.
        train_threads: Default number of threads of a fit; small networks are as fast on one as on two.
        shipped_dir: Folder of the shipped models; unset for `models/` of the clone.
    """

    device: str = Field(default="auto", pattern=r"^(auto|cpu|cuda:\d+)$")
    train_threads: int = Field(default=1, ge=1, le=256)
    shipped_dir: Path | None = None


def open_store(name: str, settings: LearnedSettings) -> ModelStore:
    """Returns the models of a service: those in the data directory and those shipped."""
    return ModelStore(settings.data_dir / "models" / name, shipped=(settings.shipped_dir or CLONE_MODELS) / name)


def learned_service(
    name: str,
    contract: ServiceDescriptor,
    *cores: object,
    models: ModelCache[M],
    batchers: Sequence[Batcher[Any, Any]],
    fits: FitService,
) -> Service:
    """Returns a learned service.

    Args:
        name: Name of the service.
        contract: The service that the cores implement; `FitService` and `ModelService` are added.
        cores: Implementations of its methods.
        models: The loaded models.
        batchers: The batchers, closed with the service.
        fits: The fits.
    """

    async def start() -> None:
        await models.start()
        await fits.start()

    async def close() -> None:
        await fits.close()
        for batcher in batchers:
            batcher.close()

    learning = learning_pb2.DESCRIPTOR.services_by_name
    return Service(
        name=name,
        methods=(
            *methods_of(contract, *cores),
            *methods_of(learning["FitService"], fits),
            *methods_of(learning["ModelService"], models),
        ),
        start=start,
        close=close,
        not_ready=lambda: models.not_ready() or next(filter(None, (each.not_ready() for each in batchers)), ""),
    )
