"""The demo's output: progress on the terminal, and the figures in a table, `summary.json` and `summary.md`."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from freerein.cli.jobs.progress import metrics_text
from freerein.cli.output import print_json
from freerein.types.orchestrator import Run

_NOTE = 60  # characters
_COLUMNS = ("figure", "value", "95 % interval", "baseline", "bar", "")


@dataclass(frozen=True)
class Figure:
    """One measured value beside what it must be compared with.

    Attributes:
        name: Key in `summary.json`, such as `reward.two_blocks.accuracy`.
        value: The value.
        baseline: Value of the trivial answer on the same data; None where there is none.
        baseline_text: The trivial answer, in words.
        interval: Lower and upper end of the value's 95 % interval; None where there is none.
        at_least: Bar that the value must reach.
        at_most: Bar that the value must not exceed.
        beats_baseline: Whether the bar is the baseline: the value, or its interval's lower end, must exceed it.
    """

    name: str
    value: float
    baseline: float | None = None
    baseline_text: str = ""
    interval: tuple[float, float] | None = None
    at_least: float | None = None
    at_most: float | None = None
    beats_baseline: bool = False

    @property
    def met(self) -> bool | None:
        """Whether the bar is met; None where there is none."""
        if self.beats_baseline and self.baseline is not None:
            return (self.interval[0] if self.interval else self.value) > self.baseline
        if self.at_least is not None:
            return self.value >= self.at_least
        return None if self.at_most is None else self.value <= self.at_most

    @property
    def bar(self) -> str:
        """The bar in words; empty where there is none."""
        if self.beats_baseline:
            return "interval above baseline" if self.interval else "above baseline"
        if self.at_least is not None:
            return f">= {self.at_least:.3g}"
        return "" if self.at_most is None else f"<= {self.at_most:.3g}"

    @property
    def cells(self) -> tuple[str, ...]:
        """The figure as a row of a table."""
        interval = f"{self.interval[0]:.3g} to {self.interval[1]:.3g}" if self.interval else ""
        baseline = "" if self.baseline is None else f"{self.baseline:.3g} ({self.baseline_text})"
        verdict = {None: "", True: "met", False: "not met"}[self.met]
        return self.name, f"{self.value:.3g}", interval, baseline, self.bar, verdict


@dataclass(frozen=True)
class Measured:
    """A figure of an evaluation.

    Attributes:
        value: The value.
        low: Lower end of its 95 % interval; None where there is none.
        high: Upper end, likewise.
        baseline: Value of the trivial answer; None where there is none.
    """

    value: float
    low: float | None
    high: float | None
    baseline: float | None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its 95 % interval; None where there is none."""
        return None if self.low is None or self.high is None else (self.low, self.high)


def summary(figures: Sequence[Figure], *, seed: int, shipped: Mapping[str, Sequence[str]]) -> dict[str, object]:
    """Returns `summary.json`: each value by name, and under `figures` its baseline, interval, bar and verdict.

    `shipped` holds by stage the models that came with freerein.
    """
    details = {
        figure.name: {
            "value": figure.value,
            "baseline": figure.baseline,
            "interval": figure.interval,
            "bar": figure.bar,
            "met": figure.met,
        }
        for figure in figures
    }
    return {**{figure.name: figure.value for figure in figures}, "seed": seed, "shipped": shipped, "figures": details}


def write(out: Path, figures: Sequence[Figure], document: Mapping[str, object]) -> None:
    """Writes `summary.json`, and the table of figures as `summary.md`."""
    (out / "summary.json").write_text(json.dumps(document, indent=2) + "\n")
    rows = [_COLUMNS, tuple("---" for _ in _COLUMNS), *(figure.cells for figure in figures)]
    (out / "summary.md").write_text("".join(f"| {' | '.join(row)} |\n" for row in rows))


class Reporter:
    """Prints progress to the terminal; with `as_json` only the summary."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._console = Console(quiet=as_json, highlight=False)

    @contextmanager
    def stage(self, title: str) -> Iterator[None]:
        """Prints the title of a stage, and at its end the duration."""
        self._console.print(f"\n[bold cyan]{title}[/]")
        started_s = time.perf_counter()
        yield
        self._console.print(f"  [green]done[/] in {time.perf_counter() - started_s:.1f} s")

    def command(self, command: str) -> None:
        """Prints the command line that does the same."""
        self._console.print(f"  [dim]$ {command}[/]", soft_wrap=True)

    def line(self, text: str) -> None:
        """Prints a line."""
        self._console.print(f"  {text}", soft_wrap=True)

    @contextmanager
    def steps(self, names: Sequence[str]) -> Iterator[Callable[[Run], None]]:
        """Yields a function that shows how far a pipeline with steps of these names has come."""
        columns = (
            TextColumn("  {task.description:<16}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("[dim]{task.fields[note]}"),
        )
        with Progress(*columns, console=self._console, disable=self._as_json) as bars:
            bar, current = bars.add_task("", total=len(names), note=""), ""

            def show(run: Run) -> None:
                nonlocal current
                step = next((name.partition("/")[0] for name in run.metrics), "")
                if step in names and step != current:
                    current = step
                    self.line(step)
                done = len(names) if run.state == "succeeded" else names.index(current) if current else 0
                bars.update(bar, completed=done, description=current or run.state, note=metrics_text(run)[:_NOTE])

            yield show

    def summary(self, figures: Sequence[Figure], document: Mapping[str, object]) -> None:
        """Prints the figures as a table, or the summary as JSON."""
        if self._as_json:
            print_json(document)
            return
        table = Table(title="\nMeasured", title_justify="left", header_style="bold")
        for column in _COLUMNS:
            table.add_column(column, justify="right" if column in ("value", "95 % interval") else "left")
        styles = {None: "", True: "[green]", False: "[red]"}
        for figure in figures:
            *cells, verdict = figure.cells
            table.add_row(*cells, styles[figure.met] + verdict)
        self._console.print(table)
