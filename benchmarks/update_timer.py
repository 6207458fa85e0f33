"""Times optimiser updates of the shipped learners in a process of its own, whose allocator the parent chooses.

python -m benchmarks.update_timer < one Turn per line, as JSON > one UpdateTimes per line, as JSON
"""

import asyncio
import json
import sys
import time
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from benchmarks import learners
from freerein.jobs.allocator import keep_freed_memory
from freerein.learning.fit import Learner
from freerein.learning.train_state import BatchSampler, TrainState

_STOP_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class Turn:
    """Updates to time. A learner is built by its first turn, continues in later turns, and is dropped for another's.

    Attributes:
        learner: Name of the learner.
        variant: Name of one of `VARIANTS`.
        updates: Number of optimiser updates.
    """

    learner: str
    variant: str
    updates: int


@dataclass(frozen=True)
class UpdateTimes:
    """Measurements of a turn.

    Attributes:
        items: Items of all batches.
        cpu_s: CPU time of the process, in seconds.
        wall_s: Wall time, in seconds.
        gather_s: CPU time before the first layer of each update, spent on gathering the batch, in seconds.
        loss: Mean training loss.
    """

    items: int
    cpu_s: float
    wall_s: float
    gather_s: float
    loss: float


@dataclass(frozen=True)
class _Setting:
    """How updates run: a variant of the learner, torch's threads, memory format and number format."""

    variant: learners.Variant = field(default_factory=learners.Variant)
    threads: int = 1
    channels_last: bool = False
    bf16: bool = False


VARIANTS: Mapping[str, _Setting] = {
    "shipped": _Setting(),
    "channels_last": _Setting(channels_last=True),
    "bf16": _Setting(bf16=True),
    "batch_x4": _Setting(learners.Variant(batch_factor=4)),
    "in_memory": _Setting(learners.Variant(in_memory=True)),
    "two_threads": _Setting(threads=2),
    "two_fits": _Setting(),  # by two processes at a time
}


class UpdateTimer:
    """The parent's end of the pipes to a process that times updates."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        if process.stdin is None or process.stdout is None:
            raise TypeError("asyncio must connect the pipes that it was asked for")
        self._requests, self._replies = process.stdin, process.stdout

    async def time(self, turn: Turn) -> UpdateTimes:
        """Returns the measurements of a turn."""
        self._requests.write(json.dumps(asdict(turn)).encode() + b"\n")
        line = await self._replies.readline()
        if not line:
            raise RuntimeError(f"The process that times {turn.learner} must answer; it ended before.")
        return UpdateTimes(**json.loads(line))

    def close(self) -> None:
        """Ends the process."""
        self._requests.close()


@asynccontextmanager
async def run_update_timer(*arguments: str) -> AsyncGenerator[UpdateTimer, None]:
    """Runs a process, with glibc's own allocation for the argument `glibc`."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *arguments, stdin=pipe, stdout=pipe)
    timer = UpdateTimer(process)
    try:
        yield timer
    finally:
        timer.close()
        await asyncio.wait_for(process.wait(), _STOP_TIMEOUT_S)


def main() -> None:
    """Answers turns until stdin closes."""
    torch.set_flush_denormal(True)  # as a fit does
    if "glibc" not in sys.argv:
        keep_freed_memory()
    trainings: dict[tuple[str, str], _Training] = {}
    with TemporaryDirectory() as folder:
        for line in sys.stdin:
            turn = Turn(**json.loads(line))
            key = turn.learner, turn.variant
            if key not in trainings:
                trainings = {other: each for other, each in trainings.items() if other[0] == turn.learner}
                trainings[key] = _Training(turn.learner, VARIANTS[turn.variant], Path(folder))
            print(json.dumps(asdict(trainings[key].run(turn.updates))), flush=True)


class _Training:
    """A learner and its training state."""

    def __init__(self, name: str, setting: _Setting, folder: Path) -> None:
        torch.set_num_threads(setting.threads)  # as a fit does before it builds its learner
        self._learner: Learner[Any] = learners.build(name, setting.variant, folder)
        self._setting = setting
        self._state: TrainState[Any] = self._learner.init(torch.Generator().manual_seed(0))
        if setting.channels_last:
            self._state.network.to(memory_format=torch.channels_last)
        self._sampler = BatchSampler.start(self._learner.size, rng=np.random.default_rng(0))
        self._first_layer_s: float | None = None
        for module in self._state.network.modules():
            module.register_forward_pre_hook(self._note_first_layer)

    def run(self, updates: int) -> UpdateTimes:
        """Runs and times some updates."""
        torch.set_num_threads(self._setting.threads)
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        gather_s, losses, items = 0.0, [], 0
        for _ in range(updates):
            started_s, self._first_layer_s = time.process_time(), None
            batch = self._sampler.next_batch(self._learner.config.batch_size)
            with torch.autocast("cpu", torch.bfloat16, enabled=self._setting.bf16):
                self._state, metrics = self._learner.update(self._state, batch)
            gather_s += (self._first_layer_s or started_s) - started_s
            losses.append(metrics["train_loss"])
            items += len(batch)
        cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
        return UpdateTimes(items, cpu_s, wall_s, gather_s, float(np.mean(losses)))

    def _note_first_layer(self, *_: object) -> None:
        if self._first_layer_s is None:
            self._first_layer_s = time.process_time()


if __name__ == "__main__":
    main()
