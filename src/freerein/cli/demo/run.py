"""The demo: starts the services, shows its parts, writes the figures, says where everything lies."""

import os
import shutil
import sys
import time
from collections.abc import AsyncGenerator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext
from pathlib import Path

from freerein.cli.connection import channel_to
from freerein.cli.demo import output_folder, report
from freerein.cli.demo.first_results import FIRST_RESULTS
from freerein.cli.demo.learning import LEARNED
from freerein.cli.demo.parts import Clients, Demo
from freerein.cli.demo.report import Figure, Reporter
from freerein.cli.output import print_json
from freerein.cli.settings import CliSettings
from freerein.clients import ImitationClient, OrchestratorClient, RewardClient, SegmentationClient, SimClient
from freerein.ports import Ports, default_ports
from freerein.stack import Endpoints, ServiceStatus, Stack, choose, free_ports, isolated_environ
from freerein.stack.endpoints import is_free, running_endpoints

_SERVICES = ("sim", "segmentation", "imitation", "reward", "orchestrator")
_READY_TIMEOUT_S = 300.0
_READY_ABOUT_S = 6.0
_PARTS = (*FIRST_RESULTS, *LEARNED)
_COPY = "var-of-demo"
_TRY_NEXT = (
    "freerein models list",
    "freerein run ppo --set task=blocks.yellow-right-of-green --watch",
)


async def run(out: Path, *, seed: int, reporter: Reporter, running: bool) -> None:
    """Shows all parts; writes `summary.json`, `summary.md` and the pictures into `out`, which is emptied first.

    With `running`, services that already run are used, where the environment says; else the demo starts its own. Raises
    ServiceError where the folder is not the demo's to empty, or a part failed.
    """
    started_s = time.monotonic()
    settings = CliSettings()
    data_dir = settings.data_dir if running else out / "data"
    output_folder.prepare(out, keep=settings.data_dir)
    about_s = sum(part.about_s for part in _PARTS) + _READY_ABOUT_S
    stopped = "the demo" if running else "everything"
    reporter.line(
        f"{len(_PARTS)} results in about {about_s / 60:.0f} minutes on two idle cores. Ctrl-C stops {stopped}."
    )
    stack = nullcontext(running_endpoints(_SERVICES, os.environ)) if running else _start(data_dir, reporter)
    async with stack as endpoints, _connected(endpoints, settings) as clients:
        ready_s = time.monotonic() - started_s
        figures, seconds = await _show_parts(Demo(out, data_dir, seed, clients, reporter))
    total_s = time.monotonic() - started_s
    summary = report.summary(figures, seed=seed, seconds={"services": ready_s, **seconds, "total": total_s})
    report.write(out, figures, summary)
    if reporter.is_quiet:
        print_json(summary)
    _say_what_is_where(reporter, out, data_dir, total_s=total_s, running=running)


async def _show_parts(demo: Demo) -> tuple[list[Figure], dict[str, float]]:
    """Returns all figures, and how long each part took."""
    figures: list[Figure] = []
    seconds: dict[str, float] = {}
    for number, part in enumerate(_PARTS, 1):
        began_s = time.monotonic()
        title = f"{number} of {len(_PARTS)}  {part.title}"
        demo.reporter.heading(title, part.learned_from, about_s=part.about_s)
        measured = await part.show(demo)
        demo.reporter.figures(measured)
        figures += measured
        seconds[part.name] = time.monotonic() - began_s
    return figures, seconds


def _say_what_is_where(reporter: Reporter, out: Path, data_dir: Path, *, total_s: float, running: bool) -> None:
    minutes, seconds = divmod(round(total_s), 60)
    reporter.console.print(f"\n[bold cyan]Done[/] in {minutes} min {seconds} s")
    reporter.line(f"pictures          {out}/*.png")
    reporter.line(f"figures           {out}/summary.md and summary.json")
    reporter.line(f"models, datasets  {data_dir}, with runs and logs")
    if running:
        reporter.line("The services still run. Try next:")
    else:
        reporter.line("All services have stopped. Try next; Ctrl-C stops `freerein up`:")
        found = "" if shutil.which("freerein") else f"PATH={Path(sys.executable).parent}:$PATH "
        reporter.line(f"  cp -r {data_dir} {_COPY}  # the next demo empties {out}")
        reporter.line(f"  export {found}FREEREIN_DATA_DIR={_COPY}  # in both terminals")
        reporter.line("  freerein up  # and open the page at the address it prints")
    for command in _TRY_NEXT:
        reporter.line(f"  {command}")


@asynccontextmanager
async def _connected(endpoints: Endpoints, settings: CliSettings) -> AsyncGenerator[Clients, None]:
    """Yields clients of all services within the block."""
    channels = {name: channel_to(address, settings) for name, address in endpoints.addresses.items()}
    async with AsyncExitStack() as stack:
        yield Clients(
            await stack.enter_async_context(SimClient(channels["sim"])),
            await stack.enter_async_context(SegmentationClient(channels["segmentation"])),
            await stack.enter_async_context(ImitationClient(channels["imitation"])),
            await stack.enter_async_context(RewardClient(channels["reward"])),
            await stack.enter_async_context(OrchestratorClient(channels["orchestrator"])),
        )


@asynccontextmanager
async def _start(data_dir: Path, reporter: Reporter) -> AsyncGenerator[Endpoints, None]:
    """Runs the demo's own services within the block; shows each as soon as it is ready."""
    environ, started_s, shown = isolated_environ(os.environ), time.monotonic(), set[str]()

    def show_ready(statuses: Sequence[ServiceStatus]) -> None:
        for status in statuses:
            if status.state == "ready" and status.service not in shown:
                shown.add(status.service)
                after_s = time.monotonic() - started_s
                reporter.line(f"{status.service:<13} ready after {after_s:.1f} s   {status.rest_url}/docs")

    async with Stack(choose(_SERVICES), data_dir=data_dir, environ=environ, ports=_ports()) as stack:
        reporter.heading("Five services start", "Each has a REST API and a gRPC server.", about_s=_READY_ABOUT_S)
        reporter.command("freerein up")
        with reporter.waiting("starting"):
            await stack.ready(timeout_s=_READY_TIMEOUT_S, on_change=show_ready)
        yield Endpoints(stack.urls, stack.addresses)


def _ports() -> dict[str, Ports]:
    """Returns the standard ports, or free ports when one of them is taken."""
    usual = {name: default_ports(name, os.environ) for name in _SERVICES}
    taken = [port for pair in usual.values() for port in (pair.rest, pair.grpc) if not is_free(port)]
    return free_ports(_SERVICES) if taken else usual
