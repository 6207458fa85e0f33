"""The rows of the table of followers: what all fits of one to the data of an exploration have measured."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.chapter3 import knots, reach, resampled
from experiments.chapter3.exploration import CEILINGS, DATA_OPTION, EXPLORING, PILOT, Exploration, is_fitted
from experiments.chapter3.followed import ACTING, GREEDY, chosen_acting
from experiments.workbench.claims import Scale
from experiments.workbench.results import ArmResult, Sample
from experiments.workbench.table import Section

STATISTICS = {"mean": resampled.mean, "median": resampled.median}
_SHARES = ("success", "contact", "stopped.goal", "ended", "failed.flag", "failed.blocked", "failed.lost")
"""Figures that are 0 or 1 in a trial."""


@dataclass(frozen=True)
class Row:
    """All fits of a row to one exploration, by seed. What a row lacks has not been run.

    Attributes:
        exploration: The world.
        method: The row.
        data: The exploration; empty for a row that needs none.
        arms: Its results, by seed.
        explored: Actions in its data; None where they have not been counted.
    """

    exploration: Exploration
    method: str
    data: str
    arms: Sequence[ArmResult]
    explored: float | None

    @property
    def name(self) -> str:
        """Row and data."""
        return "_".join(each for each in (self.method, self.data) if each)

    @property
    def is_claimed(self) -> bool:
        """Whether claims rest on it."""
        return (self.method, self.data) == self.exploration.claimed

    @property
    def scale(self) -> Scale | None:
        """Whether data and updates are as many as they have to be; None for what is not fitted, or not counted."""
        if not is_fitted(self.method) or self.method in CEILINGS or self.explored is None:
            return None
        is_short = self.explored < self.exploration.timesteps or self.exploration.is_reduced(self.method)
        return "reduced" if is_short else "full"

    @property
    def samples(self) -> dict[int, dict[str, Sample]]:
        """Samples of each seed, of all kinds of settings."""
        found: dict[int, dict[str, Sample]] = {}
        for arm in self.arms:
            found.setdefault(arm.seed, {}).update(arm.samples)
        return found

    def acting(self, samples: Mapping[str, Sample], setting: str) -> str:
        """Returns the way of acting that a fit chose for a setting; empty where it has not been evaluated."""
        chosen = chosen_acting(samples, self.exploration.all_settings[setting].choice)
        return chosen if is_fitted(self.method) else GREEDY

    def chosen(self, setting: str, figure: str) -> dict[int, Sample]:
        """Returns a figure of each seed that has it, of the way of acting that its fit chose."""
        names = {seed: f"{self.acting(found, setting)}.{setting}.{figure}" for seed, found in self.samples.items()}
        return {seed: self.samples[seed][name] for seed, name in names.items() if name in self.samples[seed]}

    def episodes(self, setting: str, figure: str) -> dict[int, resampled.Episodes]:
        """Returns the same as float64 (1, demonstrations, starts)."""
        demonstrations = self.exploration.all_settings[setting].demonstrations
        return {
            seed: resampled.by_demonstration([sample], demonstrations=demonstrations)
            for seed, sample in self.chosen(setting, figure).items()
        }


def rows_of(exploration: Exploration, results: Sequence[ArmResult]) -> list[Row]:
    """Returns the rows that have results, of those of the world of an exploration."""
    found: dict[tuple[str, str], list[ArmResult]] = {}
    own = [each for each in results if each.world == exploration.world and each.method != PILOT]
    for each in sorted(own, key=lambda result: result.seed):
        found.setdefault((each.method, each.options.get(DATA_OPTION, "")), []).append(each)
    explored = {data: arms[0].figures[reach.EXPLORED] for (row, data), arms in found.items() if row == EXPLORING}
    return [
        Row(exploration, method, data, arms, explored.get(data))
        for (method, data), arms in found.items()
        if method != EXPLORING
    ]


def sections(rows: Sequence[Row]) -> Iterator[Section]:
    """Yields the cells of every fit by setting and way of acting, and those by landmark, figure by figure."""
    figures = rows[0].exploration.figures if rows else ()
    for figure in figures:
        columns = _columns(rows, figure)
        if columns:
            header = ("row", "data", "seed", *(f"{setting}, {acting}" for setting, acting in columns))
            yield Section(header, tuple(_cells(rows, columns, figure)), figure)
    for figure in figures:
        if by_landmark := tuple(_by_landmark(rows, figure)):
            most = max(map(len, by_landmark))
            header = ("row", "data", "seed", "setting", "acting", *(str(n) for n in range(1, most - 4)))
            filled = tuple((*cells, *[""] * (most - len(cells))) for cells in by_landmark)
            yield Section(header, filled, f"{figure} by landmark, means")


def _columns(rows: Sequence[Row], figure: str) -> list[tuple[str, str]]:
    """Returns the settings and ways of acting in which any row has a figure."""
    known = {name for row in rows for found in row.samples.values() for name in found}
    settings = rows[0].exploration.all_settings
    return [(setting, acting) for setting in settings for acting in ACTING if f"{acting}.{setting}.{figure}" in known]


def _cells(rows: Sequence[Row], columns: Sequence[tuple[str, str]], figure: str) -> Iterator[tuple[str, ...]]:
    for row in rows:
        for seed, found in row.samples.items():
            cells = [
                _cell(
                    found.get(f"{acting}.{setting}.{figure}"),
                    row.exploration.all_settings[setting].demonstrations,
                    figure,
                )
                for setting, acting in columns
            ]
            if any(cells):
                yield row.method, row.data, str(seed), *cells


def _cell(sample: Sample | None, demonstrations: int, figure: str) -> str:
    """Returns a share, or a median with the mean beside it, and its interval over demonstrations and starts."""
    if sample is None:
        return ""
    episodes = resampled.by_demonstration([sample], demonstrations=demonstrations)
    if figure in _SHARES:
        low, high = resampled.interval(episodes, resampled.mean)
        return f"{episodes.mean():.1%} [{low:.1%}, {high:.1%}]"
    low, high = resampled.interval(episodes, resampled.median)
    return f"{np.median(episodes):.3g} [{low:.3g}, {high:.3g}], mean {episodes.mean():.3g}"


def _by_landmark(rows: Sequence[Row], figure: str) -> Iterator[tuple[str, ...]]:
    """Yields the means of a figure at each landmark, of every fit in the way of acting that it chose."""
    for row in rows:
        for seed, found in row.samples.items():
            for setting in row.exploration.all_settings:
                acting, means = row.acting(found, setting), list[str]()
                while (name := f"{acting}.{setting}.{figure}.{len(means)}") in found:
                    means.append(f"{found[name].mean:.3g}")
                if means:
                    yield row.method, row.data, str(seed), setting, acting, *means


def reached(results: Sequence[ArmResult]) -> Iterator[Section]:
    """Yields how much was explored, how far explorations get, and knots among them, where that is known."""
    counted = (reach.EXPLORED, reach.LEARNED, reach.STILL, knots.DISPLACEMENTS, knots.KNOTS)
    moved = [f"moved.{actions}.{quantile}" for actions in reach.ACTIONS for quantile in reach.QUANTILES]
    explored = [each for each in results if each.method == EXPLORING]
    known = [name for name in (*counted, *moved) if any(name in each.figures for each in explored)]
    if explored:
        header = ("data", *(_TITLES.get(name) or "{1} actions, {2}".format(*name.split(".")) for name in known))
        yield Section(header, tuple(row for each in explored for row in _explored(each, known)), "Exploration")


def _explored(result: ArmResult, known: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yields the cells of an exploration, and of its parts, as far as these have been measured."""
    data, part = result.options[DATA_OPTION], 0
    yield data, *(_number(name, result.figures.get(name)) for name in known)
    while any(f"part.{part}.{name}" in result.figures for name in known):
        yield f"{data}, part {part + 1}", *(_number(name, result.figures.get(f"part.{part}.{name}")) for name in known)
        part += 1


_TITLES = {
    reach.EXPLORED: "actions",
    reach.LEARNED: "learned from before",
    reach.STILL: "share that changed no pixel",
    knots.DISPLACEMENTS: "made again",
    knots.KNOTS: "knots",
}


def _number(name: str, value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if name in _TITLES and name != reach.STILL else f"{value:.3g}"
