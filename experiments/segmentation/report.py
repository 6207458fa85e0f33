"""Tables of segmentation experiments: a row for each method and context, accuracies in per cent."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from experiments.segmentation.dataset import SPLITS, SplitName
from experiments.segmentation.evaluation import FRAME_ACCURACY
from experiments.workbench import claims
from experiments.workbench.claims import Claim, Scale
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table

SUPERVISED = "supervised"
"""Method of the ceiling: cross-entropy on true labels."""

_HEADER = (
    "method",
    "context",
    *(f"{split} accuracy, % [95 % interval]" for split in SPLITS),
    "dissertation, %",
    "test balanced, %",
    "test edit, %",
    "test F1@50, %",
    "gap closed, test",
    "seeds",
    "minutes",
    "CPU minutes",
)
_LEAST_GAP = 0.5  # per cent
_OTHER_FIGURES = ("balanced_accuracy", "edit_score", "f1_at_50")


class Row(NamedTuple):
    """What tells the rows of the table apart; a guess has no context."""

    method: str
    context: str = ""


_BASELINE = Row("lse", "causal")


@dataclass(frozen=True)
class Report:
    """The words of a table, and what its figures are compared with.

    Attributes:
        experiment: Name of the experiment.
        title: Heading of the table.
        text: What was measured, and how, in Markdown.
        dissertation_trajectories: Number of training trajectories in the dissertation; None where it has no such table.
        dissertation: The dissertation's accuracies in per cent, by row: train, validation, test.
    """

    experiment: str
    title: str
    text: str
    dissertation_trajectories: int | None = None
    dissertation: Mapping[Row, tuple[float, float, float]] = field(default_factory=dict)


def table(report: Report, results: Sequence[ArmResult], *, trajectories_seen: int) -> Table:
    """Returns the table of the given results: rows in their order, with a claim for each split.

    Its scale is `full` when a network sees at least the dissertation's number of training trajectories.
    """
    rows: dict[Row, list[ArmResult]] = {}
    for result in results:
        rows.setdefault(_row(result), []).append(result)
    scale = _scale(report, trajectories_seen)
    made = {row: [_claim(report, scale, rows, row, split) for split in SPLITS] for row in rows}
    draw = partial(
        interval_plot,
        [each[-1] for each in made.values()],
        title=report.title,
        unit="frame accuracy on test trajectories, per cent",
    )
    return Table(
        title=report.title,
        text=f"{report.text}\n\n{_scale_text(report, scale, trajectories_seen)}",
        sections=(Section(_HEADER, tuple(_cells(row, rows[row], made[row]) for row in rows)),),
        claims=tuple(claim for each in made.values() for claim in each),
        picture=Picture("Values, 95 % intervals, ceilings", draw),
    )


def _scale(report: Report, seen: int) -> Scale:
    return "reduced" if report.dissertation_trajectories is None or seen < report.dissertation_trajectories else "full"


def _scale_text(report: Report, scale: Scale, seen: int) -> str:
    theirs = report.dissertation_trajectories
    amount = _spaced(seen) if theirs is None else f"{_spaced(seen)} of the dissertation's {_spaced(theirs)}"
    return f"Scale `{scale}`: a network sees {amount} training trajectories."


def _spaced(count: int) -> str:
    return f"{count:,}".replace(",", " ")


def _row(result: ArmResult) -> Row:
    return Row(result.method, result.options.get("context", ""))


def _claim(report: Report, scale: Scale, rows: Mapping[Row, Sequence[ArmResult]], row: Row, split: SplitName) -> Claim:
    arms = rows[row]
    pattern = arms[0].name.removesuffix(str(arms[0].seed)) + "*"
    samples = [arm.samples[f"{split}.{FRAME_ACCURACY}"] for arm in arms]
    value = _accuracy(arms, split)
    low, high = claims.interval(samples, rng=np.random.default_rng(0))
    compared = {other: _accuracy(rows[other], split) for other in rows if other != row and row.context}
    baseline, ceiling = compared.get(_BASELINE), compared.get(Row(SUPERVISED, row.context))
    gap_closed = claims.gap_closed(value, baseline=baseline, ceiling=ceiling, least_gap=_LEAST_GAP)
    dissertation = report.dissertation.get(row)
    return Claim(
        claim=".".join([report.experiment, *filter(None, row), split]),
        value=round(value, 3),
        low=round(100 * low, 3),
        high=round(100 * high, 3),
        seeds=len(arms) if row.context else None,
        trials=len(samples[0].totals),
        scale=scale,
        baseline=None if baseline is None else round(baseline, 3),
        ceiling=None if ceiling is None else round(ceiling, 3),
        gap_closed=None if gap_closed is None else round(gap_closed, 3),
        dissertation=None if dissertation is None else dissertation[SPLITS.index(split)],
        target=None,
        met=None,
        world_hash=arms[0].world_hash,
        command=f"python -m experiments run {report.experiment} --only '{pattern}'",
        minutes=round(sum(arm.minutes for arm in arms), 2),
    )


def _accuracy(arms: Sequence[ArmResult], split: SplitName) -> float:
    """Returns the mean frame accuracy over seeds, in per cent."""
    return 100 * claims.mean([arm.samples[f"{split}.{FRAME_ACCURACY}"] for arm in arms])


def _cells(row: Row, arms: Sequence[ArmResult], made: Sequence[Claim]) -> tuple[str, ...]:
    test = made[-1]
    others = (float(np.mean([arm.figures[f"test.{name}"] for arm in arms])) for name in _OTHER_FIGURES)
    return (
        row.method,
        row.context,
        *(f"{claim.value:.2f} [{claim.low:.2f}, {claim.high:.2f}]" for claim in made),
        "" if test.dissertation is None else " / ".join(f"{claim.dissertation:g}" for claim in made),
        *(f"{100 * value:.2f}" for value in others),
        "" if test.gap_closed is None else f"{test.gap_closed:.2f}",
        "" if test.seeds is None else str(test.seeds),
        f"{test.minutes:.1f}",
        f"{sum(arm.cpu_minutes for arm in arms):.1f}",
    )
