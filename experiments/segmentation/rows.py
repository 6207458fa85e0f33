"""Rows of a table: the arms of one world that differ in the seed alone, and their figures."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from experiments.segmentation.decoded import Decoded
from experiments.segmentation.evaluation import ACTION_LOSS, DECODED_ACCURACY, GUESSED_TAG_LOSS, IS_DECIDED, TAG_LOSS
from experiments.segmentation.guesses import TRUTH
from experiments.segmentation.methods import CHOSEN, RECIPE
from experiments.segmentation.study import SUPERVISED
from experiments.workbench import claims
from experiments.workbench.results import ArmResult, Sample

PER_CENT = 100


class Row(NamedTuple):
    """The key of a row among those of its world; a guess has no context."""

    method: str
    context: str = ""


BASELINE = Row("lse", "causal")
"""The dissertation's method."""

PUBLISHED = ("lse", "lse_as_published", "mil", "fcn_mil", "ccnn", "ccnn_without_share")
"""Objectives that the dissertation compares; any of them, in any context, may be the best baseline."""

LEAST_GAP = 0.5
"""Per cent between baseline and ceiling below which the share of the gap that is closed means nothing."""

_MOST_OF_GUESSED = 0.98
"""Loss of held-out tags, relative to that of the best constant scores, from which on a network has learned nothing."""


_DISSERTATION = Path(__file__).parents[1] / "results" / "dissertation.json"


def dissertation(table: str) -> dict[str, dict[Row, tuple[float, float, float]]]:
    """Returns what the dissertation prints in a table such as `table_2_2`, in per cent: three figures by world and row.

    They are accuracies in train, validation and test; in `table_2_3` of labels, of kept labels, and subtasks done.
    """
    worlds: dict[str, dict[str, tuple[float, float, float]]] = json.loads(_DISSERTATION.read_bytes())[table]
    return {world: {Row(*row.split()): each for row, each in rows.items()} for world, rows in worlds.items()}


@dataclass(frozen=True)
class Rows:
    """The arms of one world that have results, by row in their order.

    Attributes:
        arms: By row.
        delays: By how many timesteps the labels of a row come late in the development world.
    """

    arms: Mapping[Row, Sequence[ArmResult]]
    delays: Mapping[Row, int] = field(default_factory=dict)

    @classmethod
    def of(cls, results: Sequence[ArmResult], world: str, *, delays: Mapping[Row, int] | None = None) -> "Rows":
        """Returns the rows of a world."""
        rows: dict[Row, list[ArmResult]] = {}
        for result in results:
            if result.world == world:
                rows.setdefault(Row(result.method, result.options.get("context", "")), []).append(result)
        return cls(rows, delays or {})

    @cached_property
    def decoded(self) -> Mapping[Row, Decoded]:
        """The decoded labels of networks beside the true ones; without rows that have none."""
        truth = self.arms.get(Row(TRUTH))
        found = {row: Decoded.of(arms, truth[0]) for row, arms in self.arms.items()} if truth else {}
        return {row: labels for row, labels in found.items() if labels is not None}

    @cached_property
    def moved(self) -> Mapping[Row, list[Sample]]:
        """The frame accuracy of decoded labels that are moved by the row's delay, by network; without other rows."""
        found = {row: labels for row, labels in self.decoded.items() if row in self.delays}
        return {row: labels.moved_samples(self.delays[row]) for row, labels in found.items()}

    def best_delays(self) -> dict[Row, int]:
        """Returns by how many timesteps decoded labels come late, by true ones; what the recipe chose is the recipe."""
        late = {row: labels.best_delay() for row, labels in self.decoded.items() if row.context}
        return late | {Row(RECIPE, row.context): by for row, by in late.items() if row.method == CHOSEN}

    def chosen(self, candidates: Iterable[Row]) -> Row | None:
        """Returns the row that is chosen without true labels, by the first seed, from those that are decided.

        Of the rows of one objective it is that with the lowest loss of held-out tags; of several objectives, that whose
        labels explain held-out actions best. Where no row is decided, all count. None where no candidate has a result.
        """
        found = [row for row in candidates if row in self.arms]
        decided = [row for row in found if self._first(row).get(IS_DECIDED, 1.0)] or found
        best: dict[str, Row] = {}
        for row in sorted(decided, key=lambda row: self._first(row)[TAG_LOSS], reverse=True):
            best[self._objective(row)] = row
        return min(best.values(), key=lambda row: self._first(row)[ACTION_LOSS]) if best else None

    def _first(self, row: Row) -> Mapping[str, float]:
        return self.arms[row][0].figures

    def _objective(self, row: Row) -> str:
        return str(cast(Any, self.arms[row][0].config["fit"])["objective"])

    def from_trial(self, first: int, figure: str) -> "Rows":
        """Returns the same rows with the samples of one figure, from a trial on; its mean in `figures` stays."""
        return Rows({row: [_from_trial(arm, first, figure) for arm in arms] for row, arms in self.arms.items()})

    def mean(self, row: Row, figure: str) -> float:
        """Returns the mean of a figure over seeds."""
        return float(np.mean([arm.figures[figure] for arm in self.arms[row]]))

    def value(self, row: Row, figure: str) -> float | None:
        """Returns the mean over seeds of a figure that has samples, in per cent; None where no arm has a result."""
        found = [arm.samples[figure] for arm in self.arms.get(row, ()) if figure in arm.samples]
        return PER_CENT * claims.mean(found) if found else None

    def interval(self, row: Row, figure: str) -> tuple[float, float]:
        """Returns the 95 % interval of `value`, in per cent."""
        samples = [arm.samples[figure] for arm in self.arms[row]]
        low, high = claims.interval(samples)
        return PER_CENT * low, PER_CENT * high

    def difference(self, row: Row, other: Row, figure: str) -> tuple[float, float]:
        """Returns the 95 % interval of how much a row is above another one on the same trials, in per cent."""
        ours, theirs = ([arm.samples[figure] for arm in self.arms[each]] for each in (row, other))
        low, high = claims.difference_interval(ours, theirs)
        return PER_CENT * low, PER_CENT * high

    def baseline(self, row: Row, figure: str) -> float | None:
        """Returns the value of the dissertation's method that a network's is compared with; None for its rows."""
        return self.value(BASELINE, figure) if row.context and row.method != BASELINE.method else None

    def best_baseline(self, figure: str) -> float | None:
        """Returns the value of that published objective and context which is best, by true labels."""
        values = [self.value(row, figure) for row in self.arms if row.method in PUBLISHED]
        return max((value for value in values if value is not None), default=None)

    def gaps(self, row: Row, figures: Sequence[str]) -> list[float | None]:
        """Returns the share of the gap to full supervision that a row closes: a sceptic takes the least.

        For each figure it is that from the dissertation's method, then that from the best baseline.
        """
        return [
            claims.gap_closed(
                self.value(row, figure) or 0.0,
                baseline=baseline,
                ceiling=self.ceiling(row, figure),
                least_gap=LEAST_GAP,
            )
            for figure in figures
            for baseline in (self.baseline(row, figure), self.best_baseline(figure))
        ]

    def moved_gap(self, row: Row) -> float | None:
        """Returns the share of the gap from the best published objective to full supervision, all decoded and moved.

        The labels of full supervision are where they are. None where a row is missing, or there is no gap.
        """
        if row not in self.moved:
            return None
        published = [PER_CENT * claims.mean(self.moved[each]) for each in self.moved if each.method in PUBLISHED]
        return claims.gap_closed(
            PER_CENT * claims.mean(self.moved[row]),
            baseline=max(published, default=None),
            ceiling=self.ceiling(row, f"test.{DECODED_ACCURACY}"),
            least_gap=LEAST_GAP,
        )

    def is_trained(self, row: Row) -> bool:
        """Returns whether the row's networks learned more of the tags than constant scores have."""
        figures = [arm.figures for arm in self.arms[row] if GUESSED_TAG_LOSS in arm.figures]
        return all(each[TAG_LOSS] < _MOST_OF_GUESSED * each[GUESSED_TAG_LOSS] for each in figures)

    def ceiling(self, row: Row, figure: str) -> float | None:
        """Returns the value with full supervision in a network's context; None for itself."""
        ceiling = Row(SUPERVISED, row.context)
        return None if row == ceiling or not row.context else self.value(ceiling, figure)


def _from_trial(arm: ArmResult, first: int, figure: str) -> ArmResult:
    found = arm.samples.get(figure)
    if found is None:
        return arm
    return replace(arm, samples={figure: Sample(found.totals[first:], found.counts[first:])})
