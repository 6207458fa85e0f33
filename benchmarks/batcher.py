"""Overhead of the batcher for a single client, and its gain for sixteen.

The model is a perceptron whose weights exceed a core's caches: most of its time is reading them, once per batch. A
batch size of 1 is batching turned off.
"""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from functools import partial

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from benchmarks.report import Ratio, Results
from benchmarks.timing import Effort, Workload, measure_rates, repeat_function, repeat_together
from benchmarks.untrained import initialise
from freerein.errors import ServiceError
from freerein.serving.batcher import Batcher
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics

_WIDTH, _LAYERS = 512, 32
_CLIENTS = 16
_MEASURED_BATCH = 8
_TIMEOUT_S = 60.0

Vector = npt.NDArray[np.float32]


async def measure(effort: Effort) -> Results:
    """Returns the ratios; first the cost of a batch of eight, which bounds the gain."""
    model = _Model()
    with ExitStack() as opened:
        on, off = (
            opened.enter_context(closing(Batcher(model.answer, queue=Limits.queue, batch=batch, metrics=Metrics())))
            for batch in (Limits.batch, 1)
        )
        bare = await measure_rates([_bare("batch-1", model, 1), _bare("batch-8", model, _MEASURED_BATCH)], effort)
        lone = await measure_rates([_clients("batching", on, 1), _clients("off", off, 1)], effort)
        many = await measure_rates([_clients("batching", on, _CLIENTS), _clients("off", off, _CLIENTS)], effort)
    cost = _MEASURED_BATCH / bare.speedup("batch-8", over="batch-1")
    return Results(
        ratios=(
            Ratio("batcher.model_batch8_vs_batch1_cost", cost, at_most=2.0),
            Ratio("batcher.lone_latency_on_vs_off", lone.speedup("off", over="batching"), at_most=1.10),
            Ratio("batcher.throughput16_on_vs_off", many.speedup("batching", over="off"), at_least=2.5),
        ),
        rates={"batcher.model": bare, "batcher.1-client": lone, "batcher.16-clients": many},
    )


class _Model:
    """Square linear layers with the batcher's interface."""

    def __init__(self) -> None:
        layers = [layer for _ in range(_LAYERS) for layer in (nn.Linear(_WIDTH, _WIDTH), nn.ReLU())]
        self._network = nn.Sequential(*layers).eval()
        initialise(self._network)

    @torch.inference_mode()
    def answer(self, items: Sequence[Vector]) -> list[Vector | ServiceError]:
        """Returns a vector for each vector, float32 (512,)."""
        return list(self._network(torch.from_numpy(np.stack(items))).numpy())


def _bare(name: str, model: _Model, size: int) -> Workload:
    return Workload(name, repeat_function(partial(model.answer, _items(size))), size, "items")


def _clients(name: str, batcher: Batcher[Vector, Vector], clients: int) -> Workload:
    """Returns clients that each submit the next item after the result of the last."""
    calls = [partial(batcher.submit, item, timeout_s=_TIMEOUT_S) for item in _items(clients)]
    return Workload(name, repeat_together(calls), clients, "items")


def _items(count: int) -> list[Vector]:
    return list(np.random.default_rng(0).standard_normal((count, _WIDTH), np.float32))
