"""Times things against one another: turn by turn, several rounds, medians."""

import math
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from statistics import median

_LONGEST_LEAP = 10.0
_MARGIN = 1.2


@dataclass(frozen=True)
class Effort:
    """How thoroughly to measure.

    Attributes:
        rounds: Turns that each contestant gets.
        turn_s: Least length of a turn, in seconds; what is short is repeated until it is reached. 0 for once.
        loads: Turns under a load that comes at its own pace.
        load_s: Length of each, in seconds.
    """

    rounds: int
    turn_s: float
    loads: int
    load_s: float


QUICK = Effort(rounds=1, turn_s=0.0, loads=1, load_s=0.5)
THOROUGH = Effort(rounds=31, turn_s=0.07, loads=5, load_s=10.0)


@dataclass(frozen=True)
class Contestant:
    """Something to be timed.

    Attributes:
        name: Its name.
        run: Does it so many times.
        things: Things got by doing it once.
        unit: What the things are, in the plural.
    """

    name: str
    run: Callable[[int], Awaitable[None]]
    things: int
    unit: str


@dataclass(frozen=True)
class Times:
    """What came of a race.

    Attributes:
        unit: What was counted.
        rates: By contestant, things per second in each round.
    """

    unit: str
    rates: dict[str, tuple[float, ...]]

    def rate(self, name: str) -> float:
        """Returns a contestant's median rate, in things per second."""
        return median(self.rates[name])

    def speedup(self, name: str, *, over: str) -> float:
        """Returns how many times as fast a contestant was as another: the median of the rounds' ratios."""
        return median(ours / theirs for ours, theirs in zip(self.rates[name], self.rates[over], strict=True))


async def race(contestants: Sequence[Contestant], effort: Effort) -> Times:
    """Times contestants that yield the same unit. They warm up, then take turns, in another order in every round."""
    repeats = {each.name: await _repeats(each, effort.turn_s) for each in contestants}
    rates: dict[str, list[float]] = {each.name: [] for each in contestants}
    for turn in range(effort.rounds):
        first = turn % len(contestants)
        for each in (*contestants[first:], *contestants[:first]):
            count = repeats[each.name]
            rates[each.name].append(each.things * count / await _seconds(each, count))
    return Times(contestants[0].unit, {name: tuple(values) for name, values in rates.items()})


async def _repeats(contestant: Contestant, turn_s: float) -> int:
    """Returns how many repetitions fill a turn, having run that many; 1, having run nothing, where any turn will do."""
    count = 1
    if not turn_s:
        return count
    await contestant.run(count)
    while (taken_s := await _seconds(contestant, count)) < turn_s:
        count = math.ceil(count * min(_LONGEST_LEAP, _MARGIN * turn_s / taken_s))
    return count


async def _seconds(contestant: Contestant, count: int) -> float:
    begun_s = time.perf_counter()
    await contestant.run(count)
    return time.perf_counter() - begun_s
