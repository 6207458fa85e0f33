"""Shows how a fit or a run goes on: live curves on a terminal; elsewhere a line, or a document, for each change."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from contextlib import aclosing, contextmanager
from typing import TypeVar

import typer

from freerein.cli.course import Course, by_telling
from freerein.cli.output import print_json
from freerein.cli.underway import Underway, steps_of
from freerein.errors import FailedPrecondition

U = TypeVar("U", bound=Underway)

INTERRUPTED = 130
"""The exit code after Ctrl-C."""

_Show = Callable[[Underway], None]

_REDRAW_S = 0.1


def watch(
    changes: AsyncGenerator[U, None], *, name: str, way_back: str, as_json: bool, metrics: Sequence[str] | None = None
) -> U:
    """Shows a fit or run until it ends; returns how it ended.

    Ctrl-C ends the program, which says how to come back; what was watched goes on.

    Args:
        changes: How it stood after each change.
        name: What it is called.
        way_back: The command that watches it again.
        as_json: Whether each change is a document of JSON.
        metrics: Whose curves are drawn; those that tell most where it is None.

    Raises:
        FailedPrecondition: It ended, but did not succeed.
    """
    try:
        with _display(name, metrics, as_json=as_json) as show:
            last = asyncio.run(_show_all(changes, show))
    except KeyboardInterrupt:
        typer.echo(f"The {name} goes on. `{way_back}` comes back to it.", err=True)
        raise typer.Exit(INTERRUPTED) from None
    if last.state != "succeeded":
        sentence = f"The {name} must succeed; its state is {last.state}. {last.error}".rstrip()
        raise FailedPrecondition(sentence, hint="Its log.txt in the data directory says more.")
    return last


def figures(now: Underway) -> str:
    """Returns the metrics of a fit or run on one line."""
    return " ".join(f"{name}={now.metrics[name]:.4g}" for name in by_telling(now.metrics))


async def _show_all(changes: AsyncGenerator[U, None], show: _Show) -> U:
    async with aclosing(changes):
        async for now in changes:
            show(now)
    return now


@contextmanager
def _display(name: str, metrics: Sequence[str] | None, *, as_json: bool) -> Iterator[_Show]:
    """Yields what shows each change."""
    from rich.console import Console
    from rich.live import Live

    from freerein.cli.course_picture import draw

    console = Console()
    if as_json:
        yield _print_document
    elif not console.is_terminal:
        yield lambda now: typer.echo(f"{name} {now.state} {steps_of(now)} {figures(now)}".rstrip())
    else:
        course = Course()
        with Live(
            console=console,
            auto_refresh=False,
            get_renderable=lambda: draw(name, course, metrics, width=console.width),
        ) as live:
            drawn_s = 0.0

            def redraw(now: Underway) -> None:
                nonlocal drawn_s
                course.add(now, at_s=time.monotonic())
                if time.monotonic() - drawn_s > _REDRAW_S:  # history comes faster than it can be drawn
                    live.refresh()
                    drawn_s = time.monotonic()

            yield redraw


def _print_document(now: Underway) -> None:
    from freerein import wire

    print_json(wire.to_json(now))
