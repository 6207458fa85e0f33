"""The table of policies that follow demonstrations: its claims, and a row for each fit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from experiments.chapter3 import fits, resampled
from experiments.chapter3.exploration import CEILINGS, EXPERT, RANDOM_SEARCH, Exploration
from experiments.chapter3.followed_rows import STATISTICS, Row, reached, rows_of, sections
from experiments.robustness.evaluated import FLAG_AUROC, FLAG_ECE
from experiments.workbench import claims
from experiments.workbench.claims import Claim, Scale
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table, words

_SEEDS, _DIGITS = 3, 3
_LEAST_AUROC = 0.85
WORST_AUROC = "goal_auroc"
"""Name of the claim of the worst flag of several worlds."""


@dataclass(frozen=True)
class Measured:
    """A figure that claims are made of.

    Attributes:
        setting: Where.
        figure: Its name.
        unit: Factor of its values.
        statistic: Of its trials: `mean` or `median`.
        claim: Name of the claim of the claimed row; empty where nothing is claimed of it.
        least: What the claimed row needs.
        ceiling: What ceilings need; None where they need nothing.
        dissertation: The dissertation's value of the claimed row.
    """

    setting: str
    figure: str
    unit: float = 100
    statistic: Literal["mean", "median"] = "mean"
    claim: str = ""
    least: float | None = None
    ceiling: float | None = None
    dissertation: float | None = None


@dataclass(frozen=True)
class Gain:
    """By how much a row is better than another.

    Attributes:
        claim: Name of the claim.
        method: The other row.
        data: The data of its fits.
        measured: What is compared.
        seeds: Fewest pairs of fits.
        is_less: Whether a smaller figure is better.
        of: The row, and the data of its fits; None for the claimed one.
        is_open: Whether it is undecided, neither met nor not, with fewer pairs or where its interval holds 0.
    """

    claim: str
    method: str
    data: str
    measured: Measured
    seeds: int = _SEEDS
    is_less: bool = False
    of: tuple[str, str] | None = None
    is_open: bool = False


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


def table(
    exploration: Exploration,
    results: Sequence[ArmResult],
    *,
    report: Report,
    others: Sequence[tuple[Exploration, Report]] = (),
) -> Table:
    """Returns the table of the arms that have results; with other worlds beside, the claim of the worst flag."""
    rows, own = rows_of(exploration, results), [each for each in results if each.world == exploration.world]
    made = [*_claims(rows, report)]
    flags = [*made, *(claim for other, its in others for claim in _claims(rows_of(other, results), its))]
    worst = _worst_auroc(
        [claim for claim in flags if claim.claim.endswith(_claim_of_flag(FLAG_AUROC))], len(others) + 1
    )
    made += worst if others else []
    shown = [claim for claim in made if claim.seeds and "flag" not in claim.claim and claim.claim != WORST_AUROC]
    draw = partial(interval_plot, shown, title="Demonstrations followed", unit=report.unit)
    return Table(
        title=report.title,
        text=words(exploration.world),
        sections=(*_gained(made, report), *sections(rows), *fits.sections(exploration, own), *reached(own)),
        claims=tuple(made),
        picture=Picture("Demonstrations followed, by row and setting", draw),
    )


def _gained(made: Sequence[Claim], report: Report) -> Iterator[Section]:
    """Yields gains with their intervals, and what was decided."""
    names = {gain.claim for gain in report.gains}
    verdicts = {True: "met", False: "not met", None: "undecided"}
    cells = [
        (each.claim, f"{each.value:g}", f"{each.low:g} to {each.high:g}", str(each.seeds), verdicts[each.met])
        for each in made
        if each.claim in names
    ]
    if cells:
        yield Section(("claim", "gain", "interval", "pairs", ""), tuple(cells), "Gains")


def _claims(rows: Sequence[Row], report: Report) -> Iterator[Claim]:
    """Yields what each row comes to, what rows gain on others, and how well the claimed one's flag tells landmarks."""
    by_name = {(row.method, row.data): row for row in rows}
    for row in rows:
        yield from _values(row, report, by_name.get((RANDOM_SEARCH, "")), by_name.get((EXPERT, "")))
    for claimed in [row for row in rows if row.is_claimed]:
        yield from _flags(claimed, report.flags)
    for gain in report.gains:
        own = by_name.get(gain.of or (rows[0].exploration.claimed if rows else ("", "")))
        if own and (other := by_name.get((gain.method, gain.data))):
            yield from _gain(gain, own, other)


def _values(row: Row, report: Report, baseline: Row | None, ceiling: Row | None) -> Iterator[Claim]:
    """Yields the figures of a row; those that are claims have the rows below and above them beside."""
    world, is_ceiling = row.exploration.world, row.method in CEILINGS
    for measured in report.measured:
        by_seed, statistic = row.episodes(measured.setting, measured.figure), STATISTICS[measured.statistic]
        if not by_seed:
            continue
        episodes = measured.unit * np.concatenate([*by_seed.values()])
        value, (low, high) = float(statistic(episodes)), resampled.interval(episodes, statistic)
        is_claim = row.is_claimed and bool(measured.claim)
        least = measured.least if is_claim else measured.ceiling if is_ceiling else None
        figure = measured.figure.replace(".", "_")
        is_enough = is_ceiling or (len(episodes) >= _SEEDS and row.scale == "full")
        yield Claim(
            claim=measured.claim if is_claim else f"{world}_{figure}_{row.name}_{measured.setting}",
            value=round(value, _DIGITS),
            low=round(low, _DIGITS),
            high=round(high, _DIGITS),
            trials=episodes[0].size,
            baseline=_value(baseline, measured) if is_claim else None,
            ceiling=_value(ceiling, measured) if is_claim else None,
            dissertation=measured.dissertation if is_claim else None,
            scale=row.scale,
            target=least,
            met=None if least is None else is_enough and value >= least,
            **_common(row.arms, len(episodes)),
        )


def _value(row: Row | None, measured: Measured) -> float | None:
    """Returns a figure of a row; None without it."""
    by_seed = row.episodes(measured.setting, measured.figure) if row else {}
    if not by_seed:
        return None
    value = STATISTICS[measured.statistic](measured.unit * np.concatenate([*by_seed.values()]))
    return round(float(value), _DIGITS)


def _gain(gain: Gain, row: Row, other: Row) -> Iterator[Claim]:
    """Yields by how much a row is better, of the seeds that both have; met where the paired interval is above 0.

    Each acts in the way that suits it. Both have the same demonstrations and starts, and are resampled together.
    """
    measured = gain.measured
    own, others = (each.episodes(measured.setting, measured.figure) for each in (row, other))
    seeds = sorted(own.keys() & others.keys())
    if not seeds:
        return
    both = measured.unit * np.stack([np.concatenate([each[seed] for seed in seeds]) for each in (own, others)])
    both, statistic = -both if gain.is_less else both, STATISTICS[measured.statistic]
    value, baseline = (float(statistic(each)) for each in both)
    low, high = resampled.gain_interval(both, statistic)
    scale = _lesser(row.scale, other.scale)
    yield Claim(
        claim=gain.claim,
        value=round(value - baseline, _DIGITS),
        low=round(low, _DIGITS),
        high=round(high, _DIGITS),
        trials=both[0, 0].size,
        baseline=round(abs(baseline), _DIGITS),
        scale=scale,
        target=0.0,
        met=_is_met(gain, low, high, pairs=len(seeds), scale=scale),
        **_common([*row.arms, *other.arms], len(seeds)),
    )


def _is_met(gain: Gain, low: float, high: float, *, pairs: int, scale: Scale | None) -> bool | None:
    """Returns whether a gain is met; None where it is undecided."""
    is_enough = pairs >= gain.seeds and scale == "full"
    if gain.is_open and (not is_enough or low <= 0 <= high):
        return None
    return is_enough and low > 0


def _lesser(scale: Scale | None, other: Scale | None) -> Scale | None:
    return "reduced" if "reduced" in (scale, other) else scale and other


def _flags(row: Row, setting: str) -> Iterator[Claim]:
    """Yields how well the policy's flag tells landmarks on the states that it visits."""
    for figure, least in ((FLAG_AUROC, _LEAST_AUROC), (FLAG_ECE, None)):
        samples = [*row.chosen(setting, figure).values()]
        if samples:
            is_enough = len(samples) >= _SEEDS and row.scale == "full"
            met = None if least is None else is_enough and claims.mean(samples) >= least
            yield claims.claim_of(
                f"{row.exploration.world}{_claim_of_flag(figure)}",
                row.arms,
                samples,
                digits=4,
                scale=row.scale,
                target=least,
                met=met,
                seeds=len(samples),
                command=f"python -m experiments run {row.exploration.world}",
            )


def _claim_of_flag(figure: str) -> str:
    return f"_{figure.replace('.', '_')}"


def _worst_auroc(flags: Sequence[Claim], worlds: int) -> list[Claim]:
    """Returns the claim of the worst flag, met by all worlds; none until each of them has one."""
    if len(flags) < worlds:
        return []
    worst = min(flags, key=lambda claim: claim.value)
    return [replace(worst, claim=WORST_AUROC, met=all(claim.met for claim in flags))]


def _common(arms: Sequence[ArmResult], seeds: int) -> dict[str, Any]:
    minutes = round(sum(arm.minutes for arm in arms), 2)
    command = f"python -m experiments run {arms[0].world}"
    return {"seeds": seeds, "minutes": minutes, "world_version": arms[0].world_version, "command": command}
