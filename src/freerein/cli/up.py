"""`freerein up`: the services as child processes, with a live table of how they stand."""

import asyncio
import json
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import aclosing, contextmanager, suppress
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from freerein.cli.output import AsJson, verb
from freerein.errors import FailedPrecondition

if TYPE_CHECKING:
    from rich.table import Table

    from freerein.cli.child import Status
    from freerein.cli.supervisor import Stack

_COLOURS = {"ready": "green", "given up": "red", "misconfigured": "red", "stopped": "dim"}

_Services = Annotated[list[str] | None, typer.Argument(help="Which; all that are installed when none is named.")]
_FreePorts = Annotated[bool, typer.Option("--free-ports", help="Listen on any free ports, not on the usual ones.")]
_Show = Callable[[tuple["Status", ...]], None]


@verb
def up(services: _Services = None, free_ports: _FreePorts = False, as_json: AsJson = False) -> None:
    """Run the services until Ctrl-C, and start again what crashes."""
    from freerein.cli import services as known
    from freerein.cli.settings import CliSettings
    from freerein.cli.supervisor import Stack

    chosen = known.choose(services or ())
    ports = known.free_ports(chosen) if free_ports else known.configured_ports(chosen, os.environ)
    stack = Stack(chosen, data_dir=CliSettings().data_dir, environ=os.environ, ports=ports)
    with _display(as_json=as_json) as show:
        asyncio.run(_run(stack, show))


async def _run(stack: "Stack", show: _Show) -> None:
    """Runs the services until a signal comes, or none of them will ever run. A second signal ends them at once."""
    this = asyncio.current_task()
    assert this is not None  # noqa: S101  # a coroutine runs in a task
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, this.cancel)
    with suppress(asyncio.CancelledError):
        async with stack, aclosing(stack.watch()) as changes:
            async for statuses in changes:
                show(statuses)
                if all(status.is_hopeless for status in statuses):
                    raise FailedPrecondition(
                        "At least one service must run; none can.", hint="`freerein doctor` says what is missing."
                    )
    show(stack.statuses)


@contextmanager
def _display(*, as_json: bool) -> Iterator[_Show]:
    """Yields what shows how the services stand: a live table on a terminal, else a line for each change."""
    from rich.console import Console
    from rich.live import Live

    console = Console()
    if console.is_terminal and not as_json:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda statuses: live.update(_table(statuses), refresh=True)
        return
    shown: dict[str, str] = {}

    def show_changes(statuses: tuple["Status", ...]) -> None:
        for status in statuses:
            line = json.dumps(asdict(status)) if as_json else _line(status)
            if shown.get(status.service) != line:
                shown[status.service] = line
                typer.echo(line)

    yield show_changes


def _line(status: "Status") -> str:
    doors = f"REST {status.rest_url}  gRPC {status.grpc_address}" if status.state == "ready" else status.reason
    return f"{status.service:<13} {status.state:<13} {doors}".rstrip()


def _table(statuses: tuple["Status", ...]) -> "Table":
    from rich.table import Table

    table = Table("service", "state", "REST", "gRPC", "restarts", "", caption="Ctrl-C stops all", box=None)
    for status in statuses:
        colour = _COLOURS.get(status.state, "yellow")
        state = f"[{colour}]{status.state}[/]"
        table.add_row(status.service, state, status.rest_url, status.grpc_address, str(status.restarts), status.reason)
    return table
