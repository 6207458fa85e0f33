"""Target values and baselines of the claims of chapter 2."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from experiments.segmentation.evaluation import DECODED_ACCURACY, FRAME_ACCURACY
from experiments.segmentation.rows import BASELINE, Row, Rows

TEST_ACCURACY, DECODED_TEST_ACCURACY = f"test.{FRAME_ACCURACY}", f"test.{DECODED_ACCURACY}"
_CLOSE_TO_DISSERTATION = 5.0


@dataclass(frozen=True)
class Target:
    """A claim to be made.

    Attributes:
        claim: Its name.
        world: Its world.
        rows: Whose figure it is: the one of these that `Rows.chosen` names.
        figure: What is measured; it has samples.
        seeds: Number of independently trained networks that it needs.
        least: What the figure must reach, in per cent.
        least_gap_closed: Share of the gap to full supervision that it must close, in all of five ways: from the
            dissertation's method here and from the best baseline, as labels are and decoded; and from the best one
            whose decoded labels are moved, where the development world says by how much.
        above: The dissertation's figure, which it must exceed, in per cent; the dissertation's method must come within
            5 points of it here.
        above_row: A row whose interval must lie below its own.
        least_figures: Other figures of the row, as shares, that must reach a least value.
        first_trial: Index of the first trajectory that counts, where those before it had been looked at already.
    """

    claim: str
    world: str
    rows: tuple[Row, ...]
    figure: str = TEST_ACCURACY
    seeds: int = 3
    least: float | None = None
    least_gap_closed: float | None = None
    above: float | None = None
    above_row: Row | None = None
    least_figures: Mapping[str, float] = field(default_factory=dict)
    first_trial: int = 0

    def counted(self, rows: Rows) -> Rows:
        """Returns the rows with the trajectories that count."""
        return rows.from_trial(self.first_trial, self.figure) if self.first_trial else rows

    def row(self, rows: Rows) -> Row:
        """Returns whose figure it is.

        Raises:
            ValueError: The method has no result.
        """
        row = rows.chosen(self.rows)
        if row is None:
            raise ValueError(f"A row must have a result in {self.world}; {self.rows} have none.")
        return row

    def least_value(self, rows: Rows) -> float | None:
        """Returns the least value that satisfies all that is asked of the value; None where it cannot be told yet."""
        row = self.row(rows)
        bounds = [bound for bound in (self.least, self.above) if bound is not None]
        if self.least_gap_closed is not None:
            baseline, ceiling = rows.best_baseline(self.figure), rows.ceiling(row, self.figure)
            if baseline is None or ceiling is None:
                return None
            bounds.append(baseline + self.least_gap_closed * max(ceiling - baseline, 0.0))
        if self.above_row is not None:
            if self.above_row not in rows.arms:
                return None
            bounds.append(rows.interval(self.above_row, self.figure)[1])
        return max(bounds)

    def missing(self, rows: Rows) -> list[str]:
        """Returns what keeps the claim from being met, as phrases; empty where it is met."""
        return list(self._missing(rows))

    def _missing(self, rows: Rows) -> Iterator[str]:
        row = self.row(rows)
        arms, value = rows.arms[row], rows.value(row, self.figure) or 0.0
        if len(arms) < self.seeds:
            yield f"{len(arms)} of {self.seeds} seeds"
        if self.least is not None and value < self.least:
            yield f"{value:.2f} is below {self.least:g}"
        if self.above is not None:
            yield from self._missing_beside_dissertation(rows, value, self.above)
        if self.least_gap_closed is not None:
            yield from self._missing_of_gap(rows, self.least_gap_closed)
        if self.above_row is not None:
            yield from self._missing_above(rows, self.above_row)
        for name, least in self.least_figures.items():
            if rows.mean(row, name) < least:
                yield f"{name} is {rows.mean(row, name):.3f}, below {least:g}"

    def _missing_beside_dissertation(self, rows: Rows, value: float, above: float) -> Iterator[str]:
        if value <= above:
            yield f"{value:.2f} is not above {above:g}"
        baseline = rows.baseline(self.row(rows), self.figure)
        if baseline is None:
            yield f"no result of {BASELINE.method}"
        elif baseline < above - _CLOSE_TO_DISSERTATION:
            yield f"the dissertation's method has {baseline:.2f} here, more than 5 points under {above:g}"

    def gaps(self, rows: Rows) -> list[float | None]:
        """Returns the five shares of the gap, of which the least counts; see `Rows.gaps` and `Rows.moved_gap`."""
        return [*rows.gaps(self.row(rows), (self.figure, DECODED_TEST_ACCURACY)), rows.moved_gap(self.row(rows))]

    def _missing_of_gap(self, rows: Rows, least: float) -> Iterator[str]:
        gaps = self.gaps(rows)
        closed = [gap for gap in gaps if gap is not None]
        if closed and min(closed) < least:
            yield f"gap closed {min(closed):.2f} is below {least:g}"
        if unknown := len(gaps) - len(closed):
            yield f"{unknown} of {len(gaps)} gaps not measured, or too small to be"

    def _missing_above(self, rows: Rows, other: Row) -> Iterator[str]:
        row = self.row(rows)
        if other not in rows.arms:
            yield f"no result of {other.method}"
        elif rows.interval(row, self.figure)[0] <= rows.interval(other, self.figure)[1]:
            low, high = rows.difference(row, other, self.figure)
            beside = f"on the same trials it is {low:.2f} to {high:.2f} above"
            yield f"its interval is not above that of {other.method}; {beside}"
