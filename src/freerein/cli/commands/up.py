"""`freerein up`: runs the services as child processes, with a live table of their states."""

import asyncio
import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import aclosing, contextmanager, suppress
from dataclasses import asdict
from typing import Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from freerein.cli.output import AsJson, command, print_error
from freerein.cli.settings import CliSettings
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, ServiceError
from freerein.ports import PORT_BASE
from freerein.stack import ServiceStatus, Stack, choose, configured_ports
from freerein.stack import free_ports as find_free_ports
from freerein.stack.certificates import certificate_problem
from freerein.stack.process import CONFIGURATION_ERROR

_COLOURS = {"ready": "green", "given up": "red", "misconfigured": "red", "stopped": "dim"}

_Services = Annotated[list[str] | None, typer.Argument(help="Services to run; all installed ones by default.")]
_FreePorts = Annotated[bool, typer.Option("--free-ports", help="Listen on free ports instead of the standard ones.")]
_BASE_HELP = "Move all ports: REST from PORT on, gRPC from 1000 above; FREEREIN_PORT_BASE tells other commands, too."
_PortBase = Annotated[int | None, typer.Option("--port-base", metavar="PORT", help=_BASE_HELP)]
_Show = Callable[[tuple["ServiceStatus", ...]], None]

app = typer.Typer(add_completion=False)


@app.command()
@command
def up(
    services: _Services = None, free_ports: _FreePorts = False, port_base: _PortBase = None, as_json: AsJson = False
) -> None:
    """Run the services until Ctrl-C; restart them when they crash.

    The last line is the address of the web page, once they have started.
    """
    try:
        stack = _stack(services or (), free_ports=free_ports, port_base=port_base)
        with _display(as_json=as_json) as show:
            asyncio.run(_run(stack, show))
    except (InvalidInput, NotFound, FailedPrecondition) as error:
        print_error(error, as_json=as_json)
        raise typer.Exit(CONFIGURATION_ERROR) from None


def _stack(services: Sequence[str], *, free_ports: bool, port_base: int | None) -> Stack:
    """Returns the services as the environment says; InvalidInput or NotFound where it is wrong."""
    if free_ports and port_base is not None:
        raise InvalidInput("--free-ports and --port-base both choose ports.", hint="Leave one out.")
    settings, chosen = CliSettings(), choose(services)
    if problem := certificate_problem(os.environ.get("FREEREIN_TLS_CERT") or None):
        raise InvalidInput(problem, field="FREEREIN_TLS_CERT", hint="Correct it, or unset it.")
    environ = os.environ if port_base is None else {**os.environ, PORT_BASE: str(port_base)}
    ports = find_free_ports(chosen) if free_ports else configured_ports(chosen, environ)
    return Stack(chosen, data_dir=settings.data_dir, environ=environ, ports=ports)


async def _run(stack: Stack, show: _Show) -> None:
    """Runs the services until a signal arrives or all have failed. A second signal kills them.

    Raises:
        FailedPrecondition: No service can start as it is configured.
        ServiceError: All services have failed, one by crashes.
    """
    this = asyncio.current_task()
    assert this is not None  # noqa: S101  # a coroutine runs in a task
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, this.cancel)
    with suppress(asyncio.CancelledError):
        async with stack, aclosing(stack.watch()) as changes:
            async for statuses in changes:
                show(statuses)
                if all(status.has_failed for status in statuses):
                    is_permanent = all(status.state == "misconfigured" for status in statuses)
                    raise (FailedPrecondition if is_permanent else ServiceError)(
                        "At least one service must run; all have failed.",
                        hint="Run `freerein doctor`.",
                    )
    show(stack.statuses)


@contextmanager
def _display(*, as_json: bool) -> Iterator[_Show]:
    """Yields a function that shows statuses: a live table on a terminal, else a line per change."""
    console = Console()
    if console.is_terminal and not as_json:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda statuses: live.update(_table(statuses), refresh=True)
        return
    shown: dict[str, str] = {}

    def show_changes(statuses: tuple["ServiceStatus", ...]) -> None:
        lines = {each.service: json.dumps(asdict(each)) if as_json else _line(each) for each in statuses}
        if not as_json:
            lines["page"] = page_line(statuses)
        for name, line in lines.items():
            if line and shown.get(name) != line:
                typer.echo(line)
            shown[name] = line

    yield show_changes


def _line(status: ServiceStatus) -> str:
    detail = f"REST {status.rest_url}  gRPC {status.grpc_address}" if status.state == "ready" else status.reason
    return f"{status.service:<13} {status.state:<13} {detail}".rstrip()


def page_line(statuses: tuple["ServiceStatus", ...]) -> str:
    """Returns where the web page is; empty while a service starts, or without the orchestrator, which has it."""
    url = next((each.rest_url for each in statuses if (each.service, each.state) == ("orchestrator", "ready")), "")
    has_started = all(each.state == "ready" or each.has_failed for each in statuses)
    return f"See and steer everything in a browser: {url}/" if url and has_started else ""


def _table(statuses: tuple["ServiceStatus", ...]) -> Table:
    caption = "\n".join(filter(None, ["Ctrl-C stops all services", page_line(statuses)]))
    table = Table("service", "state", "REST", "gRPC", "restarts", "", caption=caption, box=None)
    for status in statuses:
        colour = _COLOURS.get(status.state, "yellow")
        state = f"[{colour}]{status.state}[/]"
        table.add_row(
            status.service, state, status.rest_url, status.grpc_address, str(status.restarts), Text(status.reason)
        )
    return table
