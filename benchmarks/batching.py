"""What the batcher costs a client who is alone, and what it gives sixteen who are not.

The model is a perceptron with weights that no cache close to a core holds: most of its time goes into reading them,
once for a batch. A batch of 1 is batching turned off.
"""

import asyncio
from collections.abc import Sequence
from contextlib import ExitStack, closing

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from benchmarks.report import Bar, Findings, Ratio
from benchmarks.rounds import Contestant, Effort, race
from freerein.errors import ServiceError
from freerein.learning import weights
from freerein.serving.batcher import Batcher
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics

_WIDTH, _LAYERS = 512, 32
_CLIENTS = 16
_MEASURED_BATCH = 8
_TIMEOUT_S = 60.0

Vector = npt.NDArray[np.float32]


async def measure(effort: Effort) -> Findings:
    """Returns the ratios; first what a batch of eight costs the model, which says how much there is to gain."""
    model = _Model()
    with ExitStack() as opened:
        batching, alone = (
            opened.enter_context(closing(Batcher(model.answer, queue=Limits.queue, batch=batch, metrics=Metrics())))
            for batch in (Limits.batch, 1)
        )
        bare = await race([_bare("batch-1", model, 1), _bare("batch-8", model, _MEASURED_BATCH)], effort)
        lone = await race([_clients("batching", batching, 1), _clients("off", alone, 1)], effort)
        many = await race([_clients("batching", batching, _CLIENTS), _clients("off", alone, _CLIENTS)], effort)
    cost = _MEASURED_BATCH / bare.speedup("batch-8", over="batch-1")
    return Findings(
        ratios=(
            Ratio("batcher.model_batch8_vs_batch1_cost", cost, Bar("at most", 2.0)),
            Ratio("batcher.lone_latency_on_vs_off", lone.speedup("off", over="batching"), Bar("at most", 1.10)),
            Ratio("batcher.throughput16_on_vs_off", many.speedup("batching", over="off"), Bar("at least", 2.5)),
        ),
        raw={"batcher.model": bare, "batcher.1-client": lone, "batcher.16-clients": many},
    )


class _Model:
    """Square linear layers, and what the batcher asks of a model."""

    def __init__(self) -> None:
        layers = [layer for _ in range(_LAYERS) for layer in (nn.Linear(_WIDTH, _WIDTH), nn.ReLU())]
        self._network = nn.Sequential(*layers).eval()
        weights.initialise(self._network, generator=torch.Generator().manual_seed(0))

    @torch.inference_mode()
    def answer(self, items: Sequence[Vector]) -> list[Vector | ServiceError]:
        """Returns a vector for each vector, float32 (512,)."""
        return list(self._network(torch.from_numpy(np.stack(items))).numpy())


def _bare(name: str, model: _Model, size: int) -> Contestant:
    items = _items(size)

    async def run(count: int) -> None:
        for _ in range(count):
            model.answer(items)

    return Contestant(name, run, size, "items")


def _clients(name: str, batcher: Batcher[Vector, Vector], clients: int) -> Contestant:
    """Returns clients who each submit an item, wait for its answer, and submit the next."""

    async def client(item: Vector, count: int) -> None:
        for _ in range(count):
            await batcher.submit(item, timeout_s=_TIMEOUT_S)

    async def run(count: int) -> None:
        await asyncio.gather(*(client(item, count) for item in _items(clients)))

    return Contestant(name, run, clients, "items")


def _items(count: int) -> list[Vector]:
    return list(np.random.default_rng(0).standard_normal((count, _WIDTH), np.float32))
