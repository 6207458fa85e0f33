"""Times single calls against one another: call by call, several rounds, quantiles."""

import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from benchmarks.rounds import Effort

Seconds: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Caller:
    """Something that is called again and again.

    Attributes:
        name: Its name.
        call: Calls once, and returns when the answer is there.
    """

    name: str
    call: Callable[[], Awaitable[object]]


@dataclass(frozen=True, eq=False)
class Latencies:
    """How long calls took.

    Attributes:
        seconds: By caller and round, how long each call took, float64 (calls,).
    """

    seconds: dict[str, tuple[Seconds, ...]]

    def quantiles(self, name: str, share: float) -> tuple[float, ...]:
        """Returns the time, in seconds, within which this share of a caller's calls was answered, by round."""
        return tuple(float(np.quantile(each, share)) for each in self.seconds[name])

    def quantile(self, name: str, share: float) -> float:
        """Returns the median of the rounds' quantiles, in seconds."""
        return median(self.quantiles(name, share))

    def ratio(self, name: str, *, over: str, share: float) -> float:
        """Returns how many times as long a caller's quantile is as another's: the median of the rounds' ratios."""
        ours, theirs = self.quantiles(name, share), self.quantiles(over, share)
        return median(mine / other for mine, other in zip(ours, theirs, strict=True))


async def time_calls(callers: Sequence[Caller], effort: Effort) -> Latencies:
    """Times callers. They warm up, then take turns, in another order in every round."""
    for each in callers:
        await _turn(each, effort.turn_s)
    seconds: dict[str, list[Seconds]] = {each.name: [] for each in callers}
    for turn in range(effort.rounds):
        first = turn % len(callers)
        for each in (*callers[first:], *callers[:first]):
            seconds[each.name].append(await _turn(each, effort.turn_s))
    return Latencies({name: tuple(rounds) for name, rounds in seconds.items()})


async def _turn(caller: Caller, turn_s: float) -> Seconds:
    """Returns how long each call of a turn took: one at least, and as many as fill it."""
    taken: list[float] = []
    end = time.perf_counter() + turn_s
    while not taken or time.perf_counter() < end:
        begun = time.perf_counter()
        await caller.call()
        taken.append(time.perf_counter() - begun)
    return np.array(taken)
