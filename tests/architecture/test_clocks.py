"""The wall clock may jump: one source file reads it, for the times of events. Log lines have theirs from structlog."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = [
    path
    for folder in ("src/freerein", "services", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "src/freerein/api" not in str(path)
]
WALL_CLOCKS = {
    *(f"time.{name}" for name in ("time", "time_ns", "localtime", "gmtime", "ctime", "strftime", "clock_gettime")),
    *(f"datetime.{name}" for name in ("now", "utcnow", "today", "datetime.now", "datetime.utcnow", "date.today")),
    "date.today",
}


@pytest.mark.fault("C23")
def test_nothing_waits_by_the_wall_clock() -> None:
    found = {f"{path.relative_to(ROOT)}: {name}" for path in SOURCES for name in names(path) & WALL_CLOCKS}
    assert found == {"src/freerein/jobs/wall_clock.py: time.time_ns"}


def names(path: Path) -> set[str]:
    """Returns the dotted names that a file uses, and the names that it imports from a module."""
    used = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute):
            used.add(ast.unparse(node))
        if isinstance(node, ast.ImportFrom):
            used |= {f"{node.module}.{alias.name}" for alias in node.names}
    return used
