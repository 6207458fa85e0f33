"""`freerein doctor`: checks this machine and the services, all at once, and prints a line per result."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from freerein.cli.doctor import machine, services
from freerein.cli.doctor.machine import CheckResult
from freerein.cli.output import AsJson, command, print_json
from freerein.cli.settings import CliSettings
from freerein.stack.endpoints import installed

_MARKS = {"ok": ("ok", "green"), "warning": ("note", "yellow"), "problem": ("problem", "bold red")}

_HELP = "Services to look at; by default those installed, and those with an address in the environment."
_Chosen = Annotated[list[str] | None, typer.Argument(metavar="SERVICES", help=_HELP)]

app = typer.Typer(add_completion=False)


@app.command()
@command
def doctor(chosen: _Chosen = None, as_json: AsJson = False) -> None:
    """Check this machine and the services; exit code 1 where something required is missing."""
    results = _check_all(chosen or ())
    if as_json:
        for result in results:
            print_json(asdict(result))
    else:
        _show(results)
    if any(result.state == "problem" for result in results):
        raise typer.Exit(1)


def _check_all(chosen: Sequence[str]) -> list[CheckResult]:
    looked_at = services.expected(installed(), chosen)
    names = installed().keys() & looked_at
    data_dir = CliSettings().data_dir
    checks: list[Callable[[], CheckResult | list[CheckResult]]] = [machine.check_python]
    if "sim" in names:
        checks.append(machine.check_rendering)
    checks += [partial(machine.check_wheels, name) for name in ("sim", "imitation") if name in names]
    if "segmentation" in names:
        checks.append(machine.check_video)
    if names - {"sim"}:
        checks += [machine.check_torch]
    checks.append(lambda: machine.check_storage(data_dir))
    checks += services.checks(looked_at)
    with ThreadPoolExecutor(len(checks)) as pool:
        found = list(pool.map(lambda check: check(), checks))
    return [result for part in found for result in (part if isinstance(part, list) else [part])]


def _show(results: list[CheckResult]) -> None:
    table = Table("", "", "found", "fix", box=None, header_style="dim", pad_edge=False)
    for result in results:
        mark, style = _MARKS[result.state]
        table.add_row(Text(mark, style), Text(result.name), Text(result.detail), Text(result.fix))
    Console().print(table)
