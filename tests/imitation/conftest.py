"""The core around the faulty policy of the fault tests, fits as child processes, and a text encoder."""

import json
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.faults import faulty_policy as policies

from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein_imitation.core import ActService, ControlService, PolicyRunner
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.language.texts import text_encoder
from freerein_imitation.methods.language.texts.wordpiece import MAX_TOKENS


@dataclass(frozen=True)
class Core:
    """The core of the service around the faulty policy, its versions, of which the first is active, and other cores."""

    act: ActService
    control: ControlService
    models: Any
    health: Health
    versions: list[ModelRef]
    around: Callable[[Any], ControlService]
    metrics: Metrics


@pytest.fixture
async def core(tmp_path: Path) -> AsyncIterator[Core]:
    versions = policies.publish_policies(tmp_path)
    store = ModelStore(tmp_path / "models" / policies.NAME)
    models: Any = ModelCache(store, lambda folder: policies.load(folder, "cpu"), fit_command="none")

    def around(policy: Any) -> ControlService:
        cache: Any = ModelCache(store, lambda _folder: policy, fit_command="none")
        return ControlService(cache, batcher, health=health, drain_s=5.0)

    metrics, health = Metrics(), Health()
    batcher = Batcher(PolicyRunner().run_batch, queue=64, batch=32, metrics=metrics)
    control = ControlService(models, batcher, health=health, drain_s=5.0)
    yield Core(ActService(models, batcher), control, models, health, versions, around, metrics)
    batcher.close()


@pytest.fixture(scope="session")
def run_fit(run_child: Callable[..., tuple[int, str]]) -> Callable[..., Path]:
    """Runs a fit in a child process to its end; returns the model's folder."""

    def run(data_dir: Path, dataset: str, values: dict[str, Any]) -> Path:
        folder = data_dir / "fit"
        folder.mkdir()
        config = METHODS.resolve(data_dir, dataset, values, threads=1)
        (folder / "config.json").write_text(json.dumps({"dataset": dataset, "config": config}))
        code, log = run_child("freerein_imitation.fit_child", folder, data_dir, "cpu")
        assert (code, [line for line in log.splitlines() if not line.startswith("Of the cameras")]) == (0, [])
        return folder / "model"

    return run


@pytest.fixture(scope="session")
def text_encoder_file() -> bytes:
    """An untrained text encoder of one layer, with embeddings of 32 numbers and a vocabulary of three words."""
    generator, width, pieces = torch.Generator().manual_seed(0), 32, ("[UNK]", "[CLS]", "[SEP]", "red", "left", "block")
    shapes = {"tokens": (len(pieces), width), "positions": (MAX_TOKENS, width)}
    shapes |= {f"layers.0.{name}": (width, width) for name in ("query", "key", "value", "attention_output")}
    shapes |= {"layers.0.intermediate": (2 * width, width), "layers.0.output": (width, 2 * width)}
    weights = {f"{name}.weight": torch.randn(shape, generator=generator) / 4 for name, shape in shapes.items()}
    weights |= {f"{name}.bias": torch.zeros(shape[0]) for name, shape in shapes.items() if name.startswith("layers")}
    for name in ("norm", "layers.0.attention_norm", "layers.0.output_norm"):
        weights |= {f"{name}.weight": torch.ones(width), f"{name}.bias": torch.zeros(width)}
    return text_encoder.pack(weights, pieces)
