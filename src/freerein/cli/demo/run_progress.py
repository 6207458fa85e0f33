"""The progress of a run of the demo: bar, curve and time left on a terminal, a line every few seconds in a log."""

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from freerein.cli.jobs.progress import Job, JobProgress
from freerein.cli.jobs.terminal_plot import plot

_BAR_WIDTH, _CURVE_WIDTH, _CURVE_LINES = 24, 48, 3


class RunProgress:
    """Progress of one run.

    Args:
        name: What runs.
        about_s: How long it takes on two idle cores.
        started_s: When it started, on the clock of `at_s` below.
        curve: Name of the metric to draw; empty for none.
        unit: What the metric is called.
    """

    def __init__(self, name: str, *, about_s: float, started_s: float, curve: str = "", unit: str = "") -> None:
        self._name, self._curve, self._unit = name, curve, unit
        self._about_s, self._started_s = about_s, started_s
        self._progress = JobProgress()

    def add(self, job: Job, *, at_s: float) -> None:
        """Adds a state of the run."""
        self._progress.add(job, at_s=at_s)

    @property
    def points(self) -> tuple[tuple[int, float], ...]:
        """Steps and values of the curve so far."""
        return self._progress.points(self._curve)

    def line(self, *, at_s: float) -> str:
        """Returns the progress as a line: what runs, n of N, for how long, how long it still takes."""
        parts = [self._steps(), f"{at_s - self._started_s:.0f} s", self._left(at_s), self._latest()]
        return f"{self._name}: " + ", ".join(filter(None, parts))

    def render(self, *, at_s: float) -> RenderableType:
        """Returns the progress as a bar, with the curve below."""
        job = self._progress.job
        done, steps = (job.step, job.steps) if job else (0, 0)
        bar = ProgressBar(total=steps or None, completed=done, width=_BAR_WIDTH, animation_time=at_s)
        row = Table.grid(padding=(0, 2))
        row.add_row(f"  {self._name}", bar, self._steps(), f"{at_s - self._started_s:.0f} s", self._left(at_s))
        return Group(row, *self.drawn_curve())

    def drawn_curve(self) -> list[Text]:
        """Returns the lines of the curve, with its range; none without two points."""
        values = [value for _, value in self.points]
        if len(values) < 2:
            return []
        low, high = f"{min(values):.3g}", f"{max(values):.3g}"
        margin = max(len(low), len(high), len(self._unit))
        labels = [high, *[""] * (_CURVE_LINES - 2), low]
        labels[_CURVE_LINES // 2] = self._unit
        lines = plot(values, width=_CURVE_WIDTH, height=_CURVE_LINES)
        drawn = [Text(f"  {label:>{margin}} ").append(line, "cyan") for label, line in zip(labels, lines, strict=True)]
        drawn[-1].append(f" now {values[-1]:.3g}")
        return drawn

    def _steps(self) -> str:
        job = self._progress.job
        return f"{job.step} of {job.steps}" if job and job.steps else "starting"

    def _left(self, at_s: float) -> str:
        job = self._progress.job
        if job and job.steps and job.step == job.steps:
            return "" if job.ended else "finishing"
        left = self._progress.seconds_left
        if left is None:
            left = self._about_s - (at_s - self._started_s)
        return f"about {left:.0f} s left" if left > 0 else "slower than on two idle cores"

    def _latest(self) -> str:
        return f"{self._unit} {self.points[-1][1]:.3g}" if self.points else ""
