"""The verb `doctor`: examines everything at once, prints a line for each."""

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from freerein.cli.output import AsJson, print_json, verb

if TYPE_CHECKING:
    from freerein.cli.doctor.finding import Finding

_MARKS = {"ok": ("ok", "green"), "warning": ("note", "yellow"), "problem": ("problem", "bold red")}


@verb
def doctor(as_json: AsJson = False) -> None:
    """Say what is missing and how to mend it; exit code 1 when something needed is missing."""
    findings = _examine()
    if as_json:
        for finding in findings:
            print_json(asdict(finding))
    else:
        _show(findings)
    if any(finding.state == "problem" for finding in findings):
        raise typer.Exit(1)


def _examine() -> "list[Finding]":
    from concurrent.futures import ThreadPoolExecutor
    from functools import partial

    from freerein.cli.doctor import doors, machine, storage
    from freerein.cli.doctor.finding import Finding
    from freerein.cli.services import installed
    from freerein.cli.settings import CliSettings

    services = installed()
    data_dir = CliSettings().data_dir
    examinations: list[Callable[[], Finding | list[Finding]]] = [machine.python]
    if "sim" in services:
        examinations += [machine.rendering, machine.meshes]
    if "imitation" in services:
        examinations.append(machine.text_tower)
    if set(services) - {"sim"}:
        examinations += [machine.torch]
    examinations += [lambda: storage.storage(data_dir), *(partial(doors.service, name) for name in services)]
    with ThreadPoolExecutor(len(examinations)) as pool:
        found = list(pool.map(lambda examine: examine(), examinations))
    return [finding for part in found for finding in (part if isinstance(part, list) else [part])]


def _show(findings: "list[Finding]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table("", "", "found", "how to mend it", box=None, header_style="dim", pad_edge=False)
    for finding in findings:
        mark, style = _MARKS[finding.state]
        table.add_row(Text(mark, style), Text(finding.name), Text(finding.detail), Text(finding.fix))
    Console().print(table)
