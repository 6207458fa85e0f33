"""Side-by-side timing: workloads take turns, in another order each round; figures are medians over rounds."""

import math
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

T = TypeVar("T")
Seconds: TypeAlias = npt.NDArray[np.float64]
Call: TypeAlias = Callable[[], Awaitable[object]]

_MAX_GROWTH = 10.0
_MARGIN = 1.2


@dataclass(frozen=True)
class Effort:
    """The effort of a measurement.

    Attributes:
        rounds: Turns of each workload.
        turn_s: Shortest turn, in seconds; short workloads are repeated to fill it. 0 for a single run.
        loads: Turns of each server under constant load.
        load_s: Length of each, in seconds.
        iterations: Iterations of each training.
        num_steps: Timesteps of each environment and iteration.
    """

    rounds: int
    turn_s: float
    loads: int
    load_s: float
    iterations: int
    num_steps: int


QUICK = Effort(rounds=1, turn_s=0.0, loads=1, load_s=0.5, iterations=1, num_steps=4)
THOROUGH = Effort(rounds=31, turn_s=0.07, loads=5, load_s=10.0, iterations=3, num_steps=32)


@dataclass(frozen=True)
class Workload:
    """Something to be timed: `run` runs it a number of times, each of which processes some items; `unit` is plural."""

    name: str
    run: Callable[[int], Awaitable[None]]
    items: int
    unit: str


def repeat(call: Call) -> Callable[[int], Awaitable[None]]:
    """Returns a function that makes a call a number of times, one after the other."""

    async def run(count: int) -> None:
        for _ in range(count):
            await call()

    return run


def repeat_function(function: Callable[[], object]) -> Callable[[int], Awaitable[None]]:
    """Returns a function that calls another a number of times."""

    async def run(count: int) -> None:
        for _ in range(count):
            function()

    return run


@dataclass(frozen=True)
class Rates:
    """Items per second of each workload in each round."""

    unit: str
    rates: dict[str, tuple[float, ...]]

    def rate(self, name: str) -> float:
        """Returns the median rate of a workload, in items per second."""
        return median(self.rates[name])

    def speedup(self, name: str, *, over: str) -> float:
        """Returns the speedup of a workload over another: the median of the rounds' ratios."""
        return median(ours / theirs for ours, theirs in zip(self.rates[name], self.rates[over], strict=True))


@dataclass(frozen=True, eq=False)
class Latencies:
    """By name and round, the latency of each call in seconds, float64 (calls,)."""

    seconds: dict[str, tuple[Seconds, ...]]

    def quantiles(self, name: str, share: float) -> tuple[float, ...]:
        """Returns a quantile of the latencies, in seconds, for each round."""
        return tuple(float(np.quantile(each, share)) for each in self.seconds[name])

    def quantile(self, name: str, share: float) -> float:
        """Returns the median of the rounds' quantiles, in seconds."""
        return median(self.quantiles(name, share))

    def ratio(self, name: str, *, over: str, share: float) -> float:
        """Returns the ratio of two quantiles: the median of the rounds' ratios."""
        ours, theirs = self.quantiles(name, share), self.quantiles(over, share)
        return median(mine / other for mine, other in zip(ours, theirs, strict=True))


async def measure_rates(workloads: Sequence[Workload], effort: Effort) -> Rates:
    """Measures the throughput of workloads of one unit, after a warm-up."""
    repeats = {each.name: await _repeats(each, effort.turn_s) for each in workloads}
    rates: dict[str, list[float]] = {each.name: [] for each in workloads}
    for each in _turns(workloads, effort.rounds):
        count = repeats[each.name]
        rates[each.name].append(each.items * count / await _seconds(each, count))
    return Rates(workloads[0].unit, {name: tuple(values) for name, values in rates.items()})


async def measure_latencies(calls: dict[str, Call], effort: Effort) -> Latencies:
    """Measures the latencies of calls, by name, after a warm-up."""
    for call in calls.values():
        await _call_latencies(call, effort.turn_s)
    seconds: dict[str, list[Seconds]] = {name: [] for name in calls}
    for name in _turns(list(calls), effort.rounds):
        seconds[name].append(await _call_latencies(calls[name], effort.turn_s))
    return Latencies({name: tuple(rounds) for name, rounds in seconds.items()})


def _turns(things: Sequence[T], rounds: int) -> Iterator[T]:
    for turn in range(rounds):
        first = turn % len(things)
        yield from (*things[first:], *things[:first])


async def _repeats(workload: Workload, turn_s: float) -> int:
    """Returns the number of runs that fill a turn, after running that many; 1 without a run if a turn may be short."""
    count = 1
    if not turn_s:
        return count
    await workload.run(count)
    while (taken_s := await _seconds(workload, count)) < turn_s:
        count = math.ceil(count * min(_MAX_GROWTH, _MARGIN * turn_s / taken_s))
    return count


async def _seconds(workload: Workload, count: int) -> float:
    started_s = time.perf_counter()
    await workload.run(count)
    return time.perf_counter() - started_s


async def _call_latencies(call: Call, turn_s: float) -> Seconds:
    """Returns the latency of each call of a turn: at least one."""
    taken: list[float] = []
    end = time.perf_counter() + turn_s
    while not taken or time.perf_counter() < end:
        started = time.perf_counter()
        await call()
        taken.append(time.perf_counter() - started)
    return np.array(taken)
