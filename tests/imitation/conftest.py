"""The faulty policy and the robots of the fault rows, for tests of the core in this process; and a small text tower."""

import importlib.util
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch

from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.serving.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_imitation.acting import BatchActor
from freerein_imitation.control import ControlStreams
from freerein_imitation.core import Actor
from freerein_imitation.model.text_tower import tower_file
from freerein_imitation.model.word_pieces import MAX_TOKENS

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
    models: Any = ModelCache(store, lambda folder: policies.load(folder, "cpu"), fit_command="none")
    batcher = Batcher(BatchActor().act_batch, queue=64, batch=32, metrics=Metrics())
    health = Health()
    streams = ControlStreams(models, batcher, health=health, drain_s=5.0)
    yield Core(Actor(models, batcher, timeout_s=10.0), streams, models, health, versions)
    batcher.close()


@pytest.fixture(scope="session")
def tower() -> bytes:
    """The file of a text tower of one layer, 32 numbers wide, that nobody trained and that knows few words."""
    generator, width, pieces = torch.Generator().manual_seed(0), 32, ("[UNK]", "[CLS]", "[SEP]", "red", "left", "block")
    shapes = {"words": (len(pieces), width), "places": (MAX_TOKENS, width)}
    shapes |= {f"layers.0.{name}": (width, width) for name in ("query", "key", "value", "out")}
    shapes |= {"layers.0.inner": (2 * width, width), "layers.0.outer": (width, 2 * width)}
    weights = {f"{name}.weight": torch.randn(shape, generator=generator) / 4 for name, shape in shapes.items()}
    weights |= {f"{name}.bias": torch.zeros(shape[0]) for name, shape in shapes.items() if name.startswith("layers")}
    for name in ("norm", "layers.0.attended", "layers.0.norm"):
        weights |= {f"{name}.weight": torch.ones(width), f"{name}.bias": torch.zeros(width)}
    return tower_file(weights, pieces)
