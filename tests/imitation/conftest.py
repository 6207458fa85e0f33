"""The faulty policy and the robots of the fault rows, for tests of the core in this process."""

import importlib.util
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.loaded import LoadedModels
from freerein.serving.metrics import Metrics
from freerein.serving.models import ModelStore
from freerein.types.common import ModelRef
from freerein_imitation.acting import BatchActor
from freerein_imitation.control import ControlStreams
from freerein_imitation.core import Actor

_FAULTS = Path(__file__).parents[1] / "faults"


def _load(name: str) -> Any:
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, _FAULTS / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


@pytest.fixture(scope="session")
def policies() -> Any:
    """The module `faulty_policy`."""
    return _load("faulty_policy")


@pytest.fixture(scope="session")
def robots() -> Any:
    """The module `control_robot`."""
    return _load("control_robot")


@dataclass(frozen=True)
class Core:
    """The core of the service around the faulty policy, and the versions that there are, the first one active."""

    actor: Actor
    streams: ControlStreams
    models: Any
    health: Health
    versions: list[ModelRef]


@pytest.fixture
async def core(policies: Any, tmp_path: Path) -> AsyncIterator[Core]:
    versions = policies.publish_policies(tmp_path)
    store = ModelStore(tmp_path / "models" / policies.NAME)
    models: Any = LoadedModels(store, lambda folder: policies.load(folder, "cpu"), fit_command="none")
    batcher = Batcher(BatchActor().act_batch, queue=64, batch=32, metrics=Metrics())
    health = Health()
    streams = ControlStreams(models, batcher, health=health, drain_s=5.0)
    yield Core(Actor(models, batcher, timeout_s=10.0), streams, models, health, versions)
    batcher.close()
