"""The table of policies that follow demonstrations: its claims, and a row for each fit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from experiments.chapter3 import reach, resampled
from experiments.chapter3.exploration import CEILINGS, DATA_OPTION, EXPLORING, Exploration, is_fitted
from experiments.chapter3.followed import ACTING, GREEDY
from experiments.robustness.evaluated import FLAG_AUROC, FLAG_ECE
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Picture, Section, Table, words
from freerein.metrics import median_interval

_SEEDS, _DIGITS = 3, 3
_LEAST_AUROC = 0.85
_STATISTICS = {"mean": resampled.mean, "median": resampled.median}


@dataclass(frozen=True)
class Measured:
    """A figure that claims are made of.

    Attributes:
        setting: Where.
        figure: Its name.
        unit: Factor of its values.
        statistic: Of its trials: `mean` or `median`.
        least: What the claimed row needs; None where nothing is claimed of it.
        ceiling: What ceilings need; None where they need nothing.
        dissertation: The dissertation's value of the claimed row.
    """

    setting: str
    figure: str
    unit: float = 100
    statistic: Literal["mean", "median"] = "mean"
    least: float | None = None
    ceiling: float | None = None
    dissertation: float | None = None


@dataclass(frozen=True)
class Gain:
    """By how much the claimed row is better than another.

    Attributes:
        claim: Name of the claim.
        method: The other row.
        data: The data of its fits.
        measured: What is compared.
        seeds: Fewest pairs of fits.
        is_less: Whether a smaller figure is better.
    """

    claim: str
    method: str
    data: str
    measured: Measured
    seeds: int = _SEEDS
    is_less: bool = False


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a table claims, beside a row for each fit.

    Attributes:
        title: Heading.
        measured: The figures.
        gains: The comparisons.
        flags: Setting in which the claimed row's flag is judged, on the states that it visits.
        unit: Unit of the values, for the picture.
    """

    title: str
    measured: Sequence[Measured]
    gains: Sequence[Gain]
    flags: str
    unit: str = "per cent"


@dataclass(frozen=True)
class _Row:
    """All fits of a row to one exploration, by seed. What a row lacks has not been run."""

    exploration: Exploration
    method: str
    data: str
    arms: Sequence[ArmResult]

    @property
    def name(self) -> str:
        return "_".join(each for each in (self.method, self.data) if each)

    @property
    def is_claimed(self) -> bool:
        return (self.method, self.data) == self.exploration.claimed

    def by_seed(self, name: str) -> dict[int, Sample]:
        """Returns a sample of each seed that has it."""
        return {arm.seed: arm.samples[name] for arm in self.arms if name in arm.samples}

    @property
    def acting(self) -> str:
        """The way of acting that follows best where that is chosen; empty where it has not been evaluated."""
        setting, figure = self.exploration.chooses
        found = {acting: self.by_seed(f"{acting}.{setting}.{figure}") for acting in ACTING}
        known = [acting for acting in ACTING if found[acting]]
        if known:
            return max(known, key=lambda acting: claims.mean([*found[acting].values()]))
        return "" if is_fitted(self.method) else GREEDY

    def episodes(self, measured: Measured, *, acting: str) -> dict[int, resampled.Episodes]:
        """Returns a figure of each seed that has it, float64 (1, demonstrations, starts)."""
        demonstrations = self.exploration.all_settings[measured.setting].demonstrations
        found = self.by_seed(f"{acting}.{measured.setting}.{measured.figure}")
        return {
            seed: measured.unit * resampled.by_demonstration([sample], demonstrations=demonstrations)
            for seed, sample in found.items()
        }


def table(exploration: Exploration, results: Sequence[ArmResult], *, report: Report) -> Table:
    """Returns the table of the arms that have results."""
    rows = _rows(exploration, results)
    made = tuple(_claims(rows, report))
    shown = [claim for claim in made if claim.seeds and "flag" not in claim.claim]
    draw = partial(interval_plot, shown, title="Demonstrations followed", unit=report.unit)
    return Table(
        title=report.title,
        text=words(exploration.world),
        sections=(
            *(Section(_header(exploration), tuple(_cells(rows, figure)), figure) for figure in exploration.figures),
            *_reached(results),
        ),
        claims=made,
        picture=Picture("Demonstrations followed, by row and setting", draw),
    )


def _rows(exploration: Exploration, results: Sequence[ArmResult]) -> list[_Row]:
    """Returns rows whose way of acting can be chosen."""
    found: dict[tuple[str, str], list[ArmResult]] = {}
    for each in sorted(results, key=lambda result: result.seed):
        found.setdefault((each.method, each.options.get(DATA_OPTION, "")), []).append(each)
    rows = [_Row(exploration, method, data, arms) for (method, data), arms in found.items()]
    return [row for row in rows if row.method != EXPLORING and row.acting]


def _header(exploration: Exploration) -> tuple[str, ...]:
    cells = (f"{name}, {acting}" for name in exploration.all_settings for acting in ACTING)
    return ("row", "data", "seed", *cells)


def _cells(rows: Sequence[_Row], figure: str) -> Iterator[tuple[str, ...]]:
    """Yields the cells of every fit: median with its interval over episodes, and the mean."""
    for row in rows:
        names = row.exploration.all_settings
        columns = [row.by_seed(f"{acting}.{name}.{figure}") for name in names for acting in ACTING]
        for seed in sorted({arm.seed for arm in row.arms}):
            yield row.method, row.data, str(seed), *(_cell(column.get(seed)) for column in columns)


def _cell(sample: Sample | None) -> str:
    if sample is None:
        return ""
    values = np.divide(sample.totals, sample.counts)
    low, high = median_interval(values)
    if set(sample.totals) <= {0, 1}:
        return f"{values.mean():.1%}"
    return f"{np.median(values):.3g} [{low:.3g}, {high:.3g}], mean {values.mean():.3g}"


def _reached(results: Sequence[ArmResult]) -> Iterator[Section]:
    """Yields how much was explored, and how far explorations get, where that is known."""
    explored = [each for each in results if each.method == EXPLORING]
    moved = [(actions, quantile) for actions in reach.ACTIONS for quantile in reach.QUANTILES]
    header = ("data", "timesteps", *(f"{actions} actions, {quantile}" for actions, quantile in moved))
    if explored:
        cells = [
            (
                each.options[DATA_OPTION],
                f"{each.figures[reach.EXPLORED]:.0f}" if reach.EXPLORED in each.figures else "",
                *(f"{each.figures[f'moved.{actions}.{quantile}']:.3g}" for actions, quantile in moved),
            )
            for each in explored
        ]
        yield Section(header, tuple(cells), "How far exploration gets")


def _claims(rows: Sequence[_Row], report: Report) -> Iterator[Claim]:
    """Yields what each row comes to, what the claimed one gains on others, and how well its flag tells landmarks."""
    for row in rows:
        yield from _values(row, report)
    by_name = {(row.method, row.data): row for row in rows}
    for claimed in [row for row in rows if row.is_claimed]:
        for gain in report.gains:
            if other := by_name.get((gain.method, gain.data)):
                yield from _gain(gain, claimed, other)
        yield from _flags(claimed, report.flags)


def _values(row: _Row, report: Report) -> Iterator[Claim]:
    world, is_ceiling = row.exploration.world, row.method in CEILINGS
    for measured in report.measured:
        by_seed, statistic = row.episodes(measured, acting=row.acting), _STATISTICS[measured.statistic]
        if not by_seed:
            continue
        episodes = np.concatenate([*by_seed.values()])
        value, (low, high) = statistic(episodes), resampled.interval(episodes, statistic)
        is_claim = row.is_claimed and measured.least is not None
        least = measured.least if is_claim else measured.ceiling if is_ceiling else None
        figure = measured.figure.replace(".", "_")
        yield Claim(
            claim=f"{world}_gsp_{measured.setting}" if is_claim else f"{world}_{figure}_{row.name}_{measured.setting}",
            value=round(value, _DIGITS),
            low=round(low, _DIGITS),
            high=round(high, _DIGITS),
            trials=episodes[0].size,
            dissertation=measured.dissertation if is_claim else None,
            scale="full" if is_claim else None,
            target=least,
            met=None if least is None else (is_ceiling or len(episodes) >= _SEEDS) and value >= least,
            **_common(row.arms, len(episodes)),
        )


def _gain(gain: Gain, row: _Row, other: _Row) -> Iterator[Claim]:
    """Yields by how much a row is better, of the seeds that both have; met where intervals are apart, too.

    Each acts in the way that suits it. Both have the same demonstrations and starts, and are resampled together.
    """
    own, others = (each.episodes(gain.measured, acting=each.acting) for each in (row, other))
    seeds = sorted(own.keys() & others.keys())
    if not seeds:
        return
    both = np.stack([np.concatenate([each[seed] for seed in seeds]) for each in (own, others)])
    statistic, sign = _STATISTICS[gain.measured.statistic], -1 if gain.is_less else 1

    def gained(pair: resampled.Episodes) -> float:
        return sign * (statistic(pair[0]) - statistic(pair[1]))

    low, high = resampled.interval(both, gained)
    (least, most), (other_least, other_most) = (resampled.interval(each, statistic) for each in both)
    is_apart = most < other_least if gain.is_less else least > other_most
    yield Claim(
        claim=gain.claim,
        value=round(gained(both), _DIGITS),
        low=round(low, _DIGITS),
        high=round(high, _DIGITS),
        trials=both[0, 0].size,
        baseline=round(statistic(both[1]), _DIGITS),
        target=0.0,
        met=len(seeds) >= gain.seeds and low > 0 and is_apart,
        **_common([*row.arms, *other.arms], len(seeds)),
    )


def _flags(row: _Row, setting: str) -> Iterator[Claim]:
    """Yields how well the policy's flag tells landmarks on the states that it visits."""
    for figure, least in ((FLAG_AUROC, _LEAST_AUROC), (FLAG_ECE, None)):
        samples = [*row.by_seed(f"{row.acting}.{setting}.{figure}").values()]
        if samples:
            met = None if least is None else len(samples) >= _SEEDS and claims.mean(samples) >= least
            yield claims.claim_of(
                f"{row.exploration.world}_{figure.replace('.', '_')}",
                row.arms,
                samples,
                digits=4,
                target=least,
                met=met,
                seeds=len(samples),
                command=f"python -m experiments run {row.exploration.world}",
            )


def _common(arms: Sequence[ArmResult], seeds: int) -> dict[str, Any]:
    minutes = round(sum(arm.minutes for arm in arms), 2)
    command = f"python -m experiments run {arms[0].world}"
    return {"seeds": seeds, "minutes": minutes, "world_version": arms[0].world_version, "command": command}
