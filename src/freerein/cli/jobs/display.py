"""Shows the progress of a fit or run: live curves on a terminal; elsewhere one line, or JSON document, per change."""

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import aclosing, contextmanager, suppress
from datetime import datetime

import typer
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from freerein import wire
from freerein.cli.connection import connect
from freerein.cli.jobs.ids import short
from freerein.cli.jobs.job_calls import CLIENTS, follow, metric_rows, noun_of
from freerein.cli.jobs.progress import Job, JobProgress, by_relevance, metrics_text, steps_text
from freerein.cli.jobs.terminal_plot import plot
from freerein.cli.output import print_json
from freerein.cli.tables import show_all
from freerein.cli.times import duration
from freerein.clients import FitClient
from freerein.errors import FailedPrecondition, Unavailable
from freerein.types.jobs import MetricRow

INTERRUPTED = 130
"""The exit code after Ctrl-C."""

_REDRAW_S = 0.1
_CURVES, _CURVE_LINES, _BAR_WIDTH = 4, 2, 30
_MIN_WIDTH, _MAX_WIDTH, _SPAN_WIDTH = 10, 60, 24
_COLOURS = {"running": "cyan", "succeeded": "green", "failed": "red", "cancelled": "yellow"}


def watch(service: str, job_id: str, *, as_json: bool, metrics: Sequence[str] | None = None) -> Job:
    """Shows a fit or run until it ends; returns its last state. Ctrl-C ends the program, not the fit or run.

    With `as_json` each change is a document; `metrics` are those that are drawn, None for the most relevant ones.
    """
    name = f"{noun_of(service)} {short(job_id)}"

    async def show_all_changes() -> Job:
        progress = JobProgress()
        with _display(name, progress, metrics, as_json=as_json) as show:
            async with (
                connect(CLIENTS.get(service, FitClient), service) as client,
                aclosing(follow(client, job_id)) as jobs,
            ):
                with suppress(Unavailable):  # `follow` waits for a service that restarts
                    progress.add_rows(await metric_rows(client, job_id))
                async for job in jobs:
                    progress.add(job, at_s=time.monotonic())
                    show(job)
        return job

    try:
        last = asyncio.run(show_all_changes())
    except KeyboardInterrupt:
        typer.echo(f"The {name} continues; `freerein jobs watch {short(job_id)}` watches it again.", err=True)
        raise typer.Exit(INTERRUPTED) from None
    check_succeeded(name, last)
    return last


def check_succeeded(name: str, job: Job) -> None:
    """Raises FailedPrecondition when a job that has ended did not succeed."""
    if job.state != "succeeded":
        sentence = f"The {name} must succeed; its state is {job.state}. {job.error}".rstrip()
        raise FailedPrecondition(
            sentence,
            hint="Its log.txt in the data directory says more; "
            f"`freerein jobs resume {short(job.id)}` goes on from its last checkpoint.",
        )


@contextmanager
def _display(
    name: str, progress: JobProgress, metrics: Sequence[str] | None, *, as_json: bool
) -> Iterator[Callable[[Job], None]]:
    """Yields a function that shows a state."""
    console, drawn_s = Console(), 0.0
    if as_json:
        yield lambda job: print_json(wire.to_json(job))
    elif not console.is_terminal:
        yield lambda job: typer.echo(_line(name, job))
    else:

        def redraw(_job: Job) -> None:
            nonlocal drawn_s
            if time.monotonic() - drawn_s > _REDRAW_S:  # history arrives faster than it can be drawn
                live.refresh()
                drawn_s = time.monotonic()

        def render() -> RenderableType:
            return draw(name, progress, metrics, width=console.width)

        with Live(console=console, auto_refresh=False, get_renderable=render) as live:
            yield redraw


def _line(name: str, job: Job) -> str:
    at = datetime.fromtimestamp(job.time_ns / 1e9).astimezone().isoformat(timespec="seconds") if job.time_ns else ""
    return f"{at} {name} {job.state} {steps_text(job)} {job.error or metrics_text(job)}".strip()


def draw(name: str, progress: JobProgress, metrics: Sequence[str] | None = None, *, width: int) -> RenderableType:
    """Returns the state of a fit or run, with the curves of `metrics` or of the most relevant ones below."""
    if progress.job is None:
        return Text(f"{name}  …", style="bold")
    state = _state_line(name, progress.job, progress.seconds_left, width=width)
    if progress.job.error:
        state = Group(state, Text(progress.job.error, "yellow"))
    shown = progress.curves(metrics, most=_CURVES)
    curves = Table.grid(padding=(0, 2, 1, 0))
    plot_width = min(_MAX_WIDTH, max(_MIN_WIDTH, width - max(map(len, shown), default=0) - _SPAN_WIDTH))
    for metric, values in shown.items():
        drawn = "\n".join(plot(values, width=plot_width, height=_CURVE_LINES))
        span = f"\n{min(values):.4g} to {max(values):.4g}"
        curves.add_row(
            Text(metric, no_wrap=True), Text(drawn, "cyan"), Text.assemble((f"{values[-1]:.4g}", "bold"), (span, "dim"))
        )
    return Group(state, curves) if curves.row_count else state


def show_metrics(rows: Sequence[MetricRow], *, as_json: bool) -> None:
    """Prints rows of metrics."""
    names = by_relevance({name for row in rows for name in row.metrics})
    cells = ([str(row.step), *(f"{row.metrics[n]:.6g}" if n in row.metrics else "" for n in names)] for row in rows)
    documents = ({"step": row.step, **row.metrics} for row in rows)
    show_all(("step", *names), cells, documents, as_json=as_json, last="left out")


def _state_line(name: str, job: Job, seconds_left: float | None, *, width: int) -> RenderableType:
    left = "" if seconds_left is None else f"{duration(seconds_left)} left"
    texts = (name, job.state, steps_text(job), left)
    room = width - sum(map(len, texts)) - 2 * len(texts)
    bar = ProgressBar(total=job.steps or None, completed=job.step, width=min(_BAR_WIDTH, max(_MIN_WIDTH, room)))
    styles = ("bold", _COLOURS.get(job.state, ""), "", "")
    before, state, steps, after = (Text(text, style, no_wrap=True) for text, style in zip(texts, styles, strict=True))
    line = Table.grid(padding=(0, 2))
    line.add_row(before, state, bar, steps, after)
    return line
