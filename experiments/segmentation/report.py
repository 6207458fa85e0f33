"""Tables of segmentation experiments: the claims, then a row for each method and context of a world, in per cent."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from experiments.segmentation.dataset import SPLITS, SplitName
from experiments.segmentation.evaluation import ACTION_LOSS, DECODED_ACCURACY, FRAME_ACCURACY
from experiments.segmentation.guesses import TRUTH, in_equal_parts
from experiments.segmentation.rows import LEAST_GAP, PER_CENT, Row, Rows
from experiments.segmentation.study import Study
from experiments.segmentation.targets import Target
from experiments.workbench import claims
from experiments.workbench.claims import Claim, Scale
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult
from experiments.workbench.table import Picture, Section, Table

DEVELOPMENT = "blocks"
"""The world in which true labels may choose."""

_ROW_HEADER = (
    "method",
    "context",
    *(f"{split}, % [95 % interval]" for split in SPLITS),
    "dissertation, %",
    "test balanced",
    "test edit",
    "test F1@50",
    "test decoded",
    "decoded edit",
    "decoded: skills begin late by, timesteps (mean ± s. d.)",
    "decoded, moved by as many as suits `blocks`, %",
    "decoded order in equal parts, %",
    "gap closed, test",
    "action loss, nats",
    "learning rate",
    "seeds",
    "minutes",
)
_CLAIM_HEADER = (
    "claim",
    "row",
    "figure",
    "value, % [95 % interval]",
    "must reach",
    "gap closed: from lse, from the best baseline; decoded, from lse, from the best; moved, from the best",
    "met",
    "missing",
)
_SEGMENT_FIGURES = ("test.balanced_accuracy", "test.edit_score", "test.f1_at_50")
_DECODED_FIGURES = (f"test.{DECODED_ACCURACY}", "test.decoded_edit_score")


@dataclass(frozen=True)
class Report:
    """The words of a table, and what its figures are compared with.

    Attributes:
        experiment: Name of the experiment.
        title: Heading of the table.
        text: What was measured, and how, in Markdown.
        dissertation_trajectories: By world, the number of training trajectories in the dissertation, where it has such
            a table.
        dissertation: By world and row, the dissertation's accuracies in per cent: train, validation, test.
        targets: The claims to be made.
    """

    experiment: str
    title: str
    text: str
    dissertation_trajectories: Mapping[str, int] = field(default_factory=dict)
    dissertation: Mapping[str, Mapping[Row, tuple[float, float, float]]] = field(default_factory=dict)
    targets: tuple[Target, ...] = ()


def table(report: Report, studies: Sequence[Study], results: Sequence[ArmResult]) -> Table:
    """Returns the table of the given results, with a claim for each target, and for each row and split.

    A world's scale is `full` when a network sees at least the dissertation's number of training trajectories.
    """
    late = Rows.of(results, DEVELOPMENT).best_delays()
    by_world = {study.world: (study, Rows.of(results, study.world, delays=late)) for study in studies}
    sections, made, plotted = [], [], []
    targets = [target for target in report.targets if by_world[target.world][1].chosen(target.rows)]
    cells_of_targets = []
    for target in targets:
        study, rows = by_world[target.world]
        counted = target.counted(rows)
        row, figure = target.row(counted), target.figure
        made.append(_claim(report, study, counted, name=target.claim, row=row, figure=figure, target=target))
        cells_of_targets.append(_target_cells(target, made[-1], counted))
    if targets:
        sections.append(Section(_CLAIM_HEADER, tuple(cells_of_targets), title="Claims"))
    for study, rows in by_world.values():
        if rows.arms:
            of_rows = {
                row: [_row_claim(report, study, rows, row, split) for split in SPLITS]
                for row in rows.arms
                if row.method != TRUTH
            }
            shown = [row for row in rows.arms if row.method != TRUTH]
            cells_of_rows = tuple(_row_cells(rows, row, of_rows[row]) for row in shown)
            sections.append(Section(_ROW_HEADER, cells_of_rows, title=f"{study.world}: {_scale_text(report, study)}"))
            made += [claim for each in of_rows.values() for claim in each]
            made += [_moved_claim(report, study, rows, row) for row in shown if row in rows.moved]
            plotted += [each[-1] for each in of_rows.values()]
    draw = partial(interval_plot, plotted, title=report.title, unit="frame accuracy on test trajectories, per cent")
    return Table(
        title=report.title,
        text=report.text,
        sections=tuple(sections),
        claims=tuple(made),
        picture=Picture("Values, 95 % intervals, ceilings", draw),
    )


def _scale(report: Report, study: Study) -> Scale | None:
    theirs = report.dissertation_trajectories.get(study.world)
    return None if theirs is None else "reduced" if study.trajectories_seen < theirs else "full"


def _scale_text(report: Report, study: Study) -> str:
    theirs, seen = report.dissertation_trajectories.get(study.world), _spaced(study.trajectories_seen)
    amount = seen if theirs is None else f"{seen} of the dissertation's {_spaced(theirs)}"
    return f"a network sees {amount} training trajectories"


def _spaced(count: int) -> str:
    return f"{count:,}".replace(",", " ")


def _claim(
    report: Report, study: Study, rows: Rows, *, name: str, row: Row, figure: str, target: Target | None = None
) -> Claim:
    arms, value = rows.arms[row], rows.value(row, figure)
    if value is None:
        raise ValueError(f"The results of {row} must have samples of {figure}.")
    baseline, ceiling = rows.baseline(row, figure), rows.ceiling(row, figure)
    gap_closed = claims.gap_closed(value, baseline=baseline, ceiling=ceiling, least_gap=LEAST_GAP)
    least = None if target is None else target.least_value(rows)
    return claims.claim_of(
        name,
        arms,
        [arm.samples[figure] for arm in arms],
        unit=PER_CENT,
        seeds=len(arms) if row.context else None,
        scale=_scale(report, study),
        baseline=None if baseline is None else round(baseline, 3),
        ceiling=None if ceiling is None else round(ceiling, 3),
        gap_closed=None if gap_closed is None else round(gap_closed, 3),
        dissertation=_dissertation(report, study.world, row, figure) if target is None else target.above,
        target=None if least is None else round(least, 3),
        met=None if target is None else not target.missing(rows) and _scale(report, study) != "reduced",
        command=_command(report, arms),
    )


def _command(report: Report, arms: Sequence[ArmResult]) -> str:
    pattern = arms[0].name.removesuffix(str(arms[0].seed)) + "*"
    return f"python -m experiments run {report.experiment} --only '{pattern}'"


def _dissertation(report: Report, world: str, row: Row, figure: str) -> float | None:
    split, _, measured = figure.partition(".")
    theirs = report.dissertation.get(world, {}).get(row)
    return None if theirs is None or measured != FRAME_ACCURACY else theirs[SPLITS.index(split)]


def _row_claim(report: Report, study: Study, rows: Rows, row: Row, split: SplitName) -> Claim:
    name = ".".join([report.experiment, study.world, *filter(None, row), split])
    return _claim(report, study, rows, name=name, row=row, figure=f"{split}.{FRAME_ACCURACY}")


def _moved_claim(report: Report, study: Study, rows: Rows, row: Row) -> Claim:
    name = ".".join([report.experiment, study.world, *row, "moved"])
    arms, samples = rows.arms[row], rows.moved[row]
    scale, command = _scale(report, study), _command(report, arms)
    return claims.claim_of(name, arms, samples, unit=PER_CENT, seeds=len(samples), scale=scale, command=command)


def _target_cells(target: Target, claim: Claim, rows: Rows) -> tuple[str, ...]:
    missing = target.missing(rows) + (["reduced scale"] if claim.scale == "reduced" else [])
    found = [] if target.least_gap_closed is None else target.gaps(rows)
    gaps = ["" if gap is None else f"{gap:.2f}" for gap in found]
    return (
        target.claim,
        " ".join(filter(None, target.row(rows))),
        target.figure,
        _value_cell(claim),
        "" if claim.target is None else f"{claim.target:.2f}",
        "; ".join(filter(None, (", ".join(gaps[:2]), ", ".join(gaps[2:4]), *gaps[4:]))) if any(gaps) else "",
        "yes" if claim.met else "no",
        "; ".join(missing),
    )


def _decoded_cells(rows: Rows, row: Row) -> tuple[str, ...]:
    """Returns how late skills begin, and accuracies of decoded labels that are moved, or of their order alone."""
    if row not in rows.decoded:
        return "", "", ""
    decoded, samples = rows.decoded[row], rows.moved.get(row)
    error = decoded.boundary_error()
    late = "" if error is None else f"{error[0]:+.1f} ± {error[1]:.1f}"
    moved_cell = f"{PER_CENT * claims.mean(samples):.2f} (by {rows.delays[row]})" if samples else ""
    return late, moved_cell, f"{PER_CENT * claims.mean(decoded.samples(in_equal_parts)):.2f}"


def _row_cells(rows: Rows, row: Row, made: Sequence[Claim]) -> tuple[str, ...]:
    test, arms = made[-1], rows.arms[row]
    rates = sorted({arm.figures["lr"] for arm in arms if "lr" in arm.figures})
    decoded = _DECODED_FIGURES if row.context else ()
    return (
        row.method if rows.is_trained(row) else f"{row.method} (not trained)",
        row.context,
        *(_value_cell(claim) for claim in made),
        "" if test.dissertation is None else " / ".join(f"{claim.dissertation:g}" for claim in made),
        *(f"{PER_CENT * rows.mean(row, name):.2f}" for name in _SEGMENT_FIGURES),
        *(f"{PER_CENT * rows.mean(row, name):.2f}" for name in decoded),
        *("" for _ in range(len(_DECODED_FIGURES) - len(decoded))),
        *_decoded_cells(rows, row),
        "" if test.gap_closed is None else f"{test.gap_closed:.2f}",
        f"{rows.mean(row, ACTION_LOSS):.3f}" if row.context else "",
        ", ".join(f"{rate:g}" for rate in rates),
        "" if test.seeds is None else str(test.seeds),
        f"{test.minutes:.1f}",
    )


def _value_cell(claim: Claim) -> str:
    return f"{claim.value:.2f} [{claim.low:.2f}, {claim.high:.2f}]"
