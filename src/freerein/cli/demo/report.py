"""The demo's output: headings, figures and progress on the terminal or in a log; `summary.json` and `summary.md`."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import wrap
from typing import Literal

from rich.console import Console
from rich.live import Live
from rich.text import Text

from freerein.cli.demo.evaluations import Measured
from freerein.cli.demo.run_progress import RunProgress

LOG_WIDTH = 80
_LINE_EVERY_S = 5.0
_REDRAWS_PER_S = 4
_NAME_WIDTH = 34
COLUMNS = ("figure", "value", "95 % interval", "baseline")


@dataclass(frozen=True)
class Figure:
    """One measured value beside the trivial answer on the same data.

    Attributes:
        name: What was measured.
        value: The value.
        unit: `%` for a share from 0 to 1, `steps` for a number of timesteps, empty for another number.
        interval: Lower and upper end of its 95 % interval; None where there is none.
        baseline: Value of the trivial answer.
        baseline_text: The trivial answer, in words.
    """

    name: str
    value: float
    unit: Literal["%", "steps", ""]
    interval: tuple[float, float] | None
    baseline: float
    baseline_text: str

    @classmethod
    def of(cls, name: str, measured: Measured, unit: Literal["%", "steps", ""], baseline_text: str) -> "Figure":
        """Returns a figure of an evaluation, which has a baseline."""
        assert measured.baseline is not None, name  # noqa: S101  # figures that the demo shows have one
        return cls(name, measured.value, unit, measured.interval, measured.baseline, baseline_text)

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Name, value, interval and baseline as text."""
        interval = f"{self._number(self.interval[0])} to {self._number(self.interval[1])}" if self.interval else ""
        unit = " %" if self.unit == "%" else ""
        baseline = f"{self.baseline_text} {self._number(self.baseline)}{unit}"
        return self.name, f"{self._number(self.value)}{unit}", interval, baseline

    @property
    def line(self) -> str:
        """The figure on one line of at most 78 characters."""
        name, value, interval, baseline = self.cells
        return f"{name:<{_NAME_WIDTH}} {value}{f' ({interval})' if interval else ''}; {baseline}"

    def _number(self, value: float) -> str:
        return {"%": f"{100 * value:.0f}", "steps": f"{value:.1f}", "": f"{value:.2f}"}[self.unit]


def write(out: Path, figures: Sequence[Figure], document: Mapping[str, object]) -> None:
    """Writes `summary.json`, and the table of figures as `summary.md`."""
    (out / "summary.json").write_text(json.dumps(document, indent=2) + "\n")
    rows = [COLUMNS, tuple("---" for _ in COLUMNS), *(figure.cells for figure in figures)]
    (out / "summary.md").write_text("".join(f"| {' | '.join(row)} |\n" for row in rows))


def summary(figures: Sequence[Figure], *, seed: int, seconds: Mapping[str, float]) -> dict[str, object]:
    """Returns `summary.json`: the figures by name, and how long each part took."""
    rounded = {part: round(each, 1) for part, each in seconds.items()}
    return {"seed": seed, "seconds": rounded, "figures": {each.name: asdict(each) for each in figures}}


class Reporter:
    """Prints to a terminal, or to a log of at most 80 columns; nothing with `is_quiet`."""

    def __init__(self, *, is_quiet: bool) -> None:
        self.is_quiet = is_quiet
        console = Console(quiet=is_quiet, highlight=False)
        self.console = console if console.is_terminal else Console(quiet=is_quiet, highlight=False, width=LOG_WIDTH)

    def heading(self, title: str, text: str, *, about_s: float) -> None:
        """Prints the title of what comes, how long it takes on two idle cores, and a sentence."""
        self.console.print(f"\n[bold cyan]{title}[/]  [dim]about {about_s:.0f} s[/]")
        self.line(text)

    def command(self, command: str) -> None:
        """Prints the command line that does the same, continued on further lines where it is long."""
        lines = wrap(f"$ {command}", self.console.width - 6, break_long_words=False, break_on_hyphens=False)
        self.console.print(Text("  " + " \\\n      ".join(lines), "dim"), soft_wrap=True)

    def line(self, text: str) -> None:
        """Prints a line."""
        self.console.print(Text(f"  {text}"))

    def picture(self, path: Path) -> None:
        """Prints where a picture is."""
        self.line(f"picture: {path}")

    def show(self, draw: Callable[[Console], None]) -> None:
        """Lets something be drawn on the console."""
        draw(self.console)

    def figures(self, figures: Sequence[Figure]) -> None:
        """Prints each figure on a line."""
        for figure in figures:
            self.console.print(Text(f"  {figure.line}", "bold"))

    def waiting(self, text: str) -> AbstractContextManager[object]:
        """Shows on a terminal that something is done within the block."""
        return self.console.status(text) if self.console.is_terminal and not self.is_quiet else nullcontext()

    @asynccontextmanager
    async def following(self, progress: RunProgress) -> AsyncIterator[None]:
        """Shows the progress of a run within the block."""
        if self.console.is_terminal:
            live = Live(
                console=self.console,
                refresh_per_second=_REDRAWS_PER_S,
                get_renderable=lambda: progress.render(at_s=time.monotonic()),
            )
            with live:
                yield
            return
        printing = asyncio.create_task(self._print_lines(progress))
        try:
            yield
        finally:
            printing.cancel()
            await asyncio.wait([printing])
        self.line(progress.line(at_s=time.monotonic()))
        for line in progress.drawn_curve():
            self.console.print(line)

    async def _print_lines(self, progress: RunProgress) -> None:
        while True:
            await asyncio.sleep(_LINE_EVERY_S)
            self.line(progress.line(at_s=time.monotonic()))
