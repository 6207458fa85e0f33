"""Items per CPU second of whole optimiser updates, as shipped and with one thing changed at a time.

A training calls `freerein.jobs.allocator.keep_freed_memory`, which must change no bit of the result;
`glibc_allocator` is the same training without it. Ratios are of CPU time, which other work on the machine disturbs
least, except those of two fits at a time, which are of wall time. A quick run measures the first learner only.
"""

import asyncio
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from statistics import median
from typing import TypeAlias

from benchmarks import learners
from benchmarks.report import Ratio, Results
from benchmarks.timing import Effort, Rates
from benchmarks.update_timer import VARIANTS, Turn, UpdateTimer, UpdateTimes, run_update_timer

_ROUNDS, _UPDATES = 5, 2
_GLIBC = "glibc_allocator"
_SHIPPED, _TWO_THREADS, _TWO_FITS = "shipped", "two_threads", "two_fits"
_BY_WALL = (_SHIPPED, _TWO_THREADS, _TWO_FITS)

_Rounds: TypeAlias = dict[str, list[UpdateTimes]]
"""By variant, the measurements of each turn."""


async def measure(effort: Effort) -> Results:
    """Returns, for each learner, the relative speed and loss of each variant."""
    results = Results()
    for name in learners.names()[: effort.rounds]:
        rounds = await _measure(name, rounds=min(effort.rounds, _ROUNDS))
        _require_equal_losses(name, rounds)
        results += _results(f"training.{name}", rounds)
    return results


async def _measure(name: str, *, rounds: int) -> _Rounds:
    """Returns the measurements of each variant, after one turn as a warm-up; each round begins with another."""
    async with AsyncExitStack() as opened:
        timers = [await opened.enter_async_context(run_update_timer(*each)) for each in (("glibc",), (), ())]
        names = (_GLIBC, *VARIANTS)
        times: _Rounds = {variant: [] for variant in names}
        for number in range(rounds + 1):
            for place in range(len(names)):
                variant = names[(number + place) % len(names)]
                times[variant].append(await _turn(name, variant, timers))
    return {variant: turns[1:] for variant, turns in times.items()}


async def _turn(name: str, variant: str, timers: Sequence[UpdateTimer]) -> UpdateTimes:
    glibc, ours, second = timers
    if variant == _GLIBC:
        return await glibc.time(Turn(name, _SHIPPED, _UPDATES))
    turn = Turn(name, variant, _UPDATES)
    if variant != _TWO_FITS:
        return await ours.time(turn)
    one, other = await asyncio.gather(ours.time(turn), second.time(turn))
    return replace(
        one, items=one.items + other.items, cpu_s=one.cpu_s + other.cpu_s, wall_s=max(one.wall_s, other.wall_s)
    )


def _results(name: str, rounds: _Rounds) -> Results:
    shipped = rounds[_SHIPPED]
    cpu = Rates("items, by CPU time", {key: tuple(t.items / t.cpu_s for t in turns) for key, turns in rounds.items()})
    wall = Rates("items", {key: tuple(t.items / t.wall_s for t in rounds[key]) for key in _BY_WALL})
    speedups = {key: cpu.speedup(key, over=_SHIPPED) for key in rounds if key not in _BY_WALL}
    return Results(
        ratios=(
            *(Ratio(f"{name}.{key}_vs_shipped", speedup) for key, speedup in speedups.items()),
            Ratio(f"{name}.bf16_loss_vs_shipped", rounds["bf16"][-1].loss / shipped[-1].loss),
            Ratio(f"{name}.two_fits_vs_two_threads", wall.speedup(_TWO_FITS, over=_TWO_THREADS)),
            Ratio(f"{name}.gather_share", median(turn.gather_s / turn.cpu_s for turn in shipped)),
        ),
        rates={name: cpu, f"{name}.wall": wall},
    )


def _require_equal_losses(name: str, rounds: _Rounds) -> None:
    """Raises RuntimeError if something that must change no bit changed the loss."""
    for variant in (_GLIBC, "in_memory", _TWO_FITS):
        if [turn.loss for turn in rounds[variant]] != [turn.loss for turn in rounds[_SHIPPED]]:
            raise RuntimeError(f"Losses of {name} must be equal as shipped and with {variant}; they differ.")
