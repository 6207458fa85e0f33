"""What a person sees of the demo: stages, the calls that are made, progress bars, and a table at the end."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live
from rich.padding import Padding
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from freerein.cli.demo.figures import Figure
from freerein.cli.job_display import draw
from freerein.cli.job_progress import Job, JobProgress
from freerein.cli.output import print_json

Advance = Callable[[int], None]


class Screen:
    """Prints to the terminal; plain lines where it is none, nothing but the summary with `as_json`."""

    def __init__(self, *, as_json: bool) -> None:
        self._as_json = as_json
        self._console = Console(quiet=as_json, highlight=False)

    @contextmanager
    def stage(self, title: str) -> Iterator[None]:
        """Announces a stage, and says how long it took."""
        self._console.print(f"\n[bold cyan]{title}[/]")
        begun = time.perf_counter()
        yield
        self._console.print(f"  [green]done[/] in {time.perf_counter() - begun:.1f} s")

    def call(self, command: str) -> None:
        """Shows a call as one would type it."""
        self._console.print(f"  [dim]$ {command}[/]", soft_wrap=True)

    def say(self, text: str) -> None:
        """Prints a line."""
        self._console.print(f"  {text}", soft_wrap=True)

    @contextmanager
    def progress(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """Yields `advance(done, note="")`, which moves a bar."""
        columns = (
            TextColumn("  {task.description:<22}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.fields[note]}"),
        )
        with Progress(*columns, console=self._console, disable=self._as_json) as bars:
            bar = bars.add_task(name, total=total, note="")

            def advance(done: int, note: str = "") -> None:
                bars.update(bar, completed=done, note=note)

            yield advance

    @contextmanager
    def course(self, name: str, metrics: Sequence[str]) -> Iterator[Callable[[Job], JobProgress]]:
        """Yields what shows how a run goes on, with curves of some metrics, and returns the course so far."""
        course = JobProgress()
        with Live(
            console=self._console,
            auto_refresh=False,
            get_renderable=lambda: Padding(draw(name, course, metrics, width=self._console.width - 2), (0, 0, 0, 2)),
        ) as live:

            def show(now: Job) -> JobProgress:
                course.add(now, at_s=time.monotonic())
                if self._console.is_terminal:
                    live.refresh()
                return course

            yield show
        if not self._console.is_terminal:
            self._console.line()  # which a live display ends only terminals' lines with

    def summary(
        self, figures: Sequence[Figure], document: dict[str, object], *, begun_with: Mapping[str, Sequence[str]]
    ) -> None:
        """Prints the figures, each met or missed, and by stage the models that were not learned here."""
        if self._as_json:
            print_json(document)
            return
        table = Table(title="\nWhat was measured", title_justify="left", header_style="bold")
        for column in ("figure", "value", "bar", ""):
            table.add_column(column, justify="right" if column in ("value", "bar") else "left")
        for figure in figures:
            verdict = "" if figure.met is None else "[green]met[/]" if figure.met else "[red]missed[/]"
            table.add_row(figure.name, f"{figure.value:.3f}", figure.bar_text, verdict)
        self._console.print(table)
        for stage, models in begun_with.items():
            self.say(f"{stage} began with what came with freerein: {', '.join(models)}")
