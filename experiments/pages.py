"""Pages that show results: templates in `words/`, whose fields are filled from committed results.

    {EXPERIMENT/NAME FIELD:FORMAT}   a field of a claim, or the mean of a figure over the arms of a pattern
    {FIELD:FORMAT}                   the same, of the claim or arms that were named before
    {table EXPERIMENT}               the first rows of its table

A field of a claim is one of `claims.Claim`, `interval`, or `cell HEADER`, a cell of its row in the table. A format is
Python's, or `pN`: in per cent, with N decimals.
"""

import json
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments import registry
from experiments.workbench.results import TABLE_FILE, ArmResult
from experiments.workbench.table import WORDS
from freerein.atomic_files import write_atomic
from freerein.errors import NotFound

_FIELD = re.compile(r"\{(?:(\w+)/(\S+) )?([^{}:]+)(?::([^{}]+))?\}")
_HEADLINES = re.compile(r"(?<=<!-- headlines -->\n\n).*?(?=\n\n<!-- end of headlines -->)", re.DOTALL)


def pages(root: Path) -> dict[Path, str]:
    """Returns the text of each page of a checkout, by path."""
    folder, readme = root / "experiments" / "results", root / "README.md"
    shown, headlines = (render((WORDS / f"{name}.md").read_text(), folder) for name in ("results", "headlines"))
    filled = _HEADLINES.sub(lambda _: headlines.strip(), readme.read_text())
    return {root / "docs" / "results.md": shown, readme: filled}


def save(root: Path) -> None:
    """Writes the pages."""
    for path, text in pages(root).items():
        write_atomic(path, text.encode())


def render(template: str, folder: Path) -> str:
    """Returns a template with its fields filled from the results in a folder.

    Raises:
        NotFound: It names what is not there.
    """
    named: Callable[[str], Any] | None = None

    def fill(found: re.Match[str]) -> str:
        nonlocal named
        experiment, name, field, form = found.groups()
        try:
            if field.startswith("table "):
                return _first_table(folder / field.removeprefix("table "))
            if experiment:
                named = _lookup(folder / experiment, name)
            return _text(named(field) if named else None, form or ".4g")
        except (KeyError, TypeError, StopIteration, OSError) as error:
            raise NotFound(f"A field of a page must be in the results; {found[0]} is not.") from error

    return _FIELD.sub(fill, template)


def _lookup(folder: Path, name: str) -> Callable[[str], Any]:
    """Returns a function that returns the fields of a claim, or the figures of arms."""
    for claim in json.loads((folder / TABLE_FILE).read_bytes())["claims"]:
        if claim["claim"] == name:
            return partial(_of_claim, claim, folder)
    return partial(_of_arms, registry.load_current(folder, name))


def _of_claim(claim: Mapping[str, Any], folder: Path, field: str) -> Any:
    if field == "interval":
        return claim["low"], claim["high"]
    if field == "met":
        return "met" if claim["met"] else "not met"
    if field.startswith("cell "):
        return _cell(folder, claim["claim"], field.removeprefix("cell "))
    return claim[field]


def _of_arms(arms: list[ArmResult], field: str) -> float | None:
    """Returns the mean over arms of a figure, a sample or a time; None without arms."""
    found = [{**{name: each.mean for name, each in arm.samples.items()}, **vars(arm), **arm.figures} for arm in arms]
    return float(np.mean([each[field] for each in found])) if found else None


def _text(value: Any, form: str) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        return " to ".join(_text(each, form) for each in value)
    return f"{100 * value:.{form[1:]}f}" if form.startswith("p") else f"{value:{form}}"


def _first_table(folder: Path) -> str:
    lines = (folder / "table.md").read_text().splitlines()
    first = next(place for place, line in enumerate(lines) if line.startswith("|"))
    return "\n".join(lines[first : lines.index("", first)])


def _cell(folder: Path, claim: str, header: str) -> str:
    """Returns a cell of a claim's row; its column's heading begins with `header`."""
    titles, *rows = ([cell.strip(" `") for cell in line.split("|")] for line in _first_table(folder).splitlines())
    column = next(place for place, title in enumerate(titles) if title.startswith(header))
    return next(row[column] for row in rows if row[1] == claim)
