"""The table of policies that follow demonstrations: its claims, and a row for each fit."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from experiments.chapter3 import resampled
from experiments.chapter3.followed import (
    ACTING,
    CEILINGS,
    CHOOSES,
    COMPLETION,
    FIGURES,
    GREEDY,
    SETTINGS,
)
from experiments.robustness.evaluated import FLAG_AUROC, FLAG_ECE
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Picture, Section, Table, words

_PER_CENT, _SEEDS, _DIGITS = 100, 3, 3
_COMMAND = "python -m experiments run doom"
_GSP, _NO_CONSISTENCY, _CURIOSITY, _RANDOM = "gsp_features", "gsp_no_consistency", "curiosity", "random"
_NAMES = [setting for of_kind in SETTINGS.values() for setting in of_kind]
_LEAST: Mapping[str, float] = {"a": 63.0, "v2": 35.0, "b": 32.0}
_DISSERTATION: Mapping[tuple[str, str, str], float] = {
    (_GSP, _CURIOSITY, "a"): 78.2,
    (_GSP, _CURIOSITY, "v2"): 49.4,
    (_GSP, _CURIOSITY, "b"): 47.1,
}
"""Median completion, per cent; tables 3.3 and A.2."""

_CEILING, _FLAG = 95.0, 0.85


@dataclass(frozen=True)
class _Row:
    """All fits of a row to one exploration: samples by name, by seed. What a row lacks has not been run."""

    method: str
    data: str
    arms: Sequence[ArmResult]

    @property
    def name(self) -> str:
        return "_".join(each for each in (self.method, self.data) if each)

    def by_seed(self, name: str) -> dict[int, Sample]:
        """Returns a sample of each seed that has it."""
        return {arm.seed: arm.samples[name] for arm in self.arms if name in arm.samples}

    @property
    def acting(self) -> str:
        """The way of acting that follows best in the setting that chooses."""
        found = {acting: self.by_seed(f"{acting}.{CHOOSES}.{COMPLETION}") for acting in ACTING}
        return max((each for each in ACTING if found[each]), key=lambda each: claims.mean([*found[each].values()]))


def table(results: Sequence[ArmResult]) -> Table:
    """Returns the table of the arms that have results."""
    rows = _rows(results)
    made = tuple(_claims(rows))
    shown = [claim for claim in made if claim.claim.startswith("doom_completion")]
    draw = partial(interval_plot, shown, title="Demonstrations followed", unit="median completion, per cent")
    return Table(
        title="Following demonstrations in rooms and corridors (Tables 3.3 and A.2)",
        text=words("doom"),
        sections=tuple(
            Section(_header(figure), tuple(_cells(rows, figure)), f"{figure.capitalize()}, %") for figure in FIGURES
        ),
        claims=made,
        picture=Picture("Completion of demonstrations by row", draw),
    )


def _rows(results: Sequence[ArmResult]) -> list[_Row]:
    """Returns rows whose way of acting can be chosen."""
    found: dict[tuple[str, str], list[ArmResult]] = {}
    for each in sorted(results, key=lambda result: result.seed):
        found.setdefault((each.method, each.options.get("data", "")), []).append(each)
    rows = [_Row(method, data, arms) for (method, data), arms in found.items()]
    return [row for row in rows if row.by_seed(f"{GREEDY}.{CHOOSES}.{COMPLETION}")]


def _header(figure: str) -> tuple[str, ...]:
    cells = (f"{name.upper()}, {acting}" for name in _NAMES for acting in ACTING)
    return ("row", "data", "seed", *cells)


def _cells(rows: Sequence[_Row], figure: str) -> Iterator[tuple[str, ...]]:
    """Yields the cells of every fit: median with its interval over episodes, and the mean."""
    for row in rows:
        columns = [row.by_seed(f"{acting}.{name}.{figure}") for name in _NAMES for acting in ACTING]
        for seed in sorted({arm.seed for arm in row.arms}):
            yield row.method, row.data, str(seed), *(_cell(column.get(seed)) for column in columns)


def _cell(sample: Sample | None) -> str:
    if sample is None:
        return ""
    percent = _PER_CENT * np.array(sample.totals, np.float64)
    low, high = resampled.median_interval(percent)
    return f"{np.median(percent):.0f} [{low:.0f}, {high:.0f}], mean {percent.mean():.1f}"


def _claims(rows: Sequence[_Row]) -> Iterator[Claim]:
    """Yields completions of each row, what curiosity and consistency bring, and how well the flag tells landmarks."""
    for row in rows:
        yield from _completions(row)
    found = {(row.method, row.data): row for row in rows}
    gsp = found.get((_GSP, _CURIOSITY))
    if gsp:
        for name, other, setting in (
            ("doom_curiosity", found.get((_GSP, _RANDOM)), "a"),
            ("doom_consistency", found.get((_NO_CONSISTENCY, _CURIOSITY)), "b"),
        ):
            if other and (gain := _gain(name, gsp, other, setting)):
                yield gain
        yield from _flags(gsp)


def _completions(row: _Row) -> Iterator[Claim]:
    is_claimed = (row.method, row.data) == (_GSP, _CURIOSITY)
    for setting in _NAMES:
        by_seed = row.by_seed(f"{row.acting}.{setting}.{COMPLETION}")
        if not by_seed:
            continue
        episodes = _PER_CENT * resampled.by_demonstration([*by_seed.values()])
        value, (low, high) = resampled.median(episodes), resampled.interval(episodes, resampled.median)
        least = _CEILING if row.method in CEILINGS else _LEAST.get(setting) if is_claimed else None
        has_seeds = row.method in CEILINGS or len(by_seed) >= _SEEDS
        yield Claim(
            claim=f"doom_gsp_{setting}" if is_claimed else f"doom_completion_{row.name}_{setting}",
            value=round(value, _DIGITS),
            low=round(low, _DIGITS),
            high=round(high, _DIGITS),
            trials=episodes[0].size,
            dissertation=_DISSERTATION.get((row.method, row.data, setting)),
            target=least,
            met=None if least is None else has_seeds and value >= least,
            **_common(row.arms, len(by_seed)),
        )


def _gain(name: str, row: _Row, other: _Row, setting: str) -> Claim | None:
    """Returns by how much more a row completes, paired by seed and episode; met where intervals are apart, too."""
    own = row.by_seed(f"{row.acting}.{setting}.{COMPLETION}")
    others = other.by_seed(f"{row.acting}.{setting}.{COMPLETION}")
    seeds = sorted(own.keys() & others.keys())
    if not seeds:
        return None
    first, second = (_PER_CENT * resampled.by_demonstration([each[seed] for seed in seeds]) for each in (own, others))
    low, high = resampled.interval(first - second, resampled.mean)
    is_apart = resampled.interval(first, resampled.mean)[0] > resampled.interval(second, resampled.mean)[1]
    return Claim(
        claim=name,
        value=round(resampled.mean(first - second), _DIGITS),
        low=round(low, _DIGITS),
        high=round(high, _DIGITS),
        trials=first[0].size,
        baseline=round(resampled.mean(second), _DIGITS),
        target=0.0,
        met=len(seeds) >= _SEEDS and low > 0 and is_apart,
        **_common([*row.arms, *other.arms], len(seeds)),
    )


def _flags(row: _Row) -> Iterator[Claim]:
    """Yields how well the policy's flag tells landmarks on the states that it visits, in the map of its data."""
    for figure, least in ((FLAG_AUROC, _FLAG), (FLAG_ECE, None)):
        by_seed = row.by_seed(f"{row.acting}.a.{figure}")
        if by_seed:
            samples = [*by_seed.values()]
            met = None if least is None else len(samples) >= _SEEDS and claims.mean(samples) >= least
            yield claims.claim_of(
                f"doom_{figure.replace('.', '_')}",
                row.arms,
                samples,
                digits=4,
                target=least,
                met=met,
                seeds=len(samples),
                command=_COMMAND,
            )


def _common(arms: Sequence[ArmResult], seeds: int) -> dict[str, Any]:
    minutes = round(sum(arm.minutes for arm in arms), 2)
    return {"seeds": seeds, "minutes": minutes, "world_version": arms[0].world_version, "command": _COMMAND}
