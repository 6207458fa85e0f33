"""Table 2.3: labels without short segments, and policies that are cloned from them, in the world `dial`."""

from collections.abc import Mapping, Sequence
from functools import partial

from experiments import table_2_2
from experiments.segmentation.evaluation import CONFIDENT_ACCURACY, FRAME_ACCURACY, KEPT_ACCURACY
from experiments.segmentation.methods import CAUSAL, OURS, WHOLE
from experiments.segmentation.rows import PER_CENT, Row, Rows, dissertation
from experiments.segmentation.zero_shot import (
    CLONED,
    EXPERT,
    RANDOM_LABELS,
    SUBTASKS,
    TRUE_LABELS,
    WHOLE_RECIPES,
    Labelled,
    ZeroShot,
)
from experiments.workbench import claims
from experiments.workbench.claims import Claim
from experiments.workbench.plots import interval_plot
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Picture, Section, Table, words

_SOURCE, _WORLD = "table_2_2", table_2_2.DIAL
_SEEDS, _SEEDS_OF_OURS = 3, 6
_LEAST_SUCCESS, _LEAST_RATIO, _LEAST_CEILING = 85.0, 0.95, 60.0
_DELAY = 7
"""Timesteps by which labels of `lse` come late in `blocks`; `confirmation` moves them by as many."""

_OURS, _TRUE = Labelled(OURS, WHOLE, seeds=_SEEDS_OF_OURS), Labelled(TRUE_LABELS, seeds=_SEEDS)
_LABELS = (
    _OURS,
    Labelled("lse", CAUSAL),
    Labelled("lse", CAUSAL, earlier=_DELAY),
    Labelled("fcn_mil", CAUSAL),
    Labelled("mil", CAUSAL),
    Labelled("ccnn", CAUSAL),
    Labelled(RANDOM_LABELS),
    _TRUE,
)
_EXPERT = Labelled(EXPERT)
_DISSERTATION = dissertation("table_2_3")[_WORLD]
_LABELLED = {
    "validation accuracy, %": FRAME_ACCURACY,
    "kept by length, %": "kept_share",
    "of the least kept skill, %": "least_kept_share",
    "accuracy of what is kept, %": KEPT_ACCURACY,
    "unsmoothed: kept, %": "unsmoothed_kept_share",
    "unsmoothed: accuracy, %": "unsmoothed_kept_accuracy",
    "kept by confidence and length, %": "confident_kept_share",
    "confident: of the least kept skill, %": "confident_least_kept_share",
    "confident: accuracy, %": CONFIDENT_ACCURACY,
}
_HEADER = (
    "labels",
    "context",
    "moved",
    *_LABELLED,
    "subtasks done, % [95 % interval]",
    "whole recipes, %",
    "dissertation: accuracy / kept / subtasks, %",
    "seeds",
)


class _Experiment(ZeroShot):
    """The arms of zero-shot execution; its table shows those of table 2.2, too."""

    def table(self, results: Sequence[ArmResult]) -> Table:
        """Returns a row for each method that has results, and the claim."""
        rows = Rows.of([each for each in results if each.method not in (CLONED, EXPERT)], _WORLD)
        executed = {labels: _executed(results, labels) for labels in (*_LABELS, _EXPERT)}
        made = {labels: _claim(labels, executed) for labels in executed if executed[labels]}
        shown = [
            each for each in executed if each in made or (not each.earlier and each.context and _row(each) in rows.arms)
        ]
        cells = (_cells(each, rows, executed[each], made.get(each)) for each in shown)
        return Table(
            title="Rejection and zero-shot execution (Table 2.3)",
            text=words("table_2_3"),
            sections=(Section(_HEADER, tuple(cells)),),
            claims=tuple(made.values()),
            picture=Picture(
                "Subtasks done",
                partial(
                    interval_plot, list(made.values()), title="Zero-shot execution", unit="subtasks done, per cent"
                ),
            ),
        )


def _row(labels: Labelled) -> Row:
    return Row(labels.method, labels.context)


def _executed(results: Sequence[ArmResult], labels: Labelled) -> list[ArmResult]:
    """Returns the results of zero-shot execution with labels."""
    if labels == _EXPERT:
        return [each for each in results if each.method == EXPERT]
    return [each for each in results if each.method == CLONED and each.options == labels.options]


def _samples(arms: Sequence[ArmResult], figure: str) -> list[Sample]:
    return [arm.samples[figure] for arm in arms]


def _claim(labels: Labelled, executed: Mapping[Labelled, Sequence[ArmResult]]) -> Claim:
    arms, ceilings = executed[labels], executed[_TRUE]
    samples = _samples(arms, SUBTASKS)
    value = PER_CENT * claims.mean(samples)
    ceiling = PER_CENT * claims.mean(_samples(ceilings, SUBTASKS)) if ceilings else None
    is_ours, theirs = labels == _OURS, _published(labels)
    return claims.claim_of(
        "dial_zero_shot" if is_ours else ".".join(["table_2_3", *labels.options.values()]),
        arms,
        samples,
        unit=PER_CENT,
        seeds=None if labels == _EXPERT else len(arms),
        scale=None if labels == _EXPERT else "full",
        ceiling=None if ceiling is None or labels in (_TRUE, _EXPERT) else round(ceiling, 3),
        dissertation=theirs[2] if theirs else None,
        target=_LEAST_SUCCESS if is_ours else None,
        met=len(arms) >= _SEEDS and (value >= _LEAST_SUCCESS or _is_close(samples, ceilings)) if is_ours else None,
        command=f"python -m experiments run table_2_3 --only '{arms[0].name.removesuffix(str(arms[0].seed))}*'",
    )


def _published(labels: Labelled) -> tuple[float, ...]:
    return () if labels.earlier else _DISSERTATION.get(_row(labels), ())


def _is_close(samples: Sequence[Sample], ceilings: Sequence[ArmResult]) -> bool:
    """Returns whether policies do nearly as well as those that are cloned from true labels, and these well enough."""
    if not ceilings:
        return False
    true = _samples(ceilings, SUBTASKS)
    low, _ = claims.ratio_interval(samples, true)
    return PER_CENT * claims.mean(true) >= _LEAST_CEILING and low >= _LEAST_RATIO


def _cells(labels: Labelled, rows: Rows, executed: Sequence[ArmResult], claim: Claim | None) -> tuple[str, ...]:
    row, described = _row(labels), ["" for _ in _LABELLED]
    if row.context and row in rows.arms and not labels.earlier:
        described = [f"{PER_CENT * rows.mean(row, f'validation.{name}'):.2f}" for name in _LABELLED.values()]
    done = ["", ""]
    if claim is not None:
        whole = PER_CENT * claims.mean(_samples(executed, WHOLE_RECIPES))
        done = [f"{claim.value:.1f} [{claim.low:.1f}, {claim.high:.1f}]", f"{whole:.1f}"]
    by = f"by {labels.earlier}" if labels.earlier else ""
    theirs = " / ".join(f"{value:g}" for value in _published(labels))
    return (*row, by, *described, *done, theirs, str(len(executed) or len(rows.arms.get(row, ()))))


EXPERIMENT = _Experiment(
    source=_SOURCE,
    study=table_2_2.EXPERIMENT.studies[0],
    labels=_LABELS,
    policies={"method": "skill_cloning", "steps": 12_000, "memory": 1, "chunk": 3, "shift": 1},
    recipes=100,
)
