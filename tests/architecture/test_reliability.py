"""`docs/reliability.md` equals `tests/faults/rows.toml` and the tests that are marked with its rows.

`python tests/architecture/test_reliability.py` rewrites its tables.
"""

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reliability.md"
ROWS: dict[str, dict[str, str]] = tomllib.loads((ROOT / "tests/faults/rows.toml").read_text())
Function = ast.FunctionDef | ast.AsyncFunctionDef
TABLE = re.compile(r"(<!-- rows: (?P<letter>[A-Z]) -->\n)\n*(?P<table>(\|.*\n)*)\n*")


def test_the_page_says_what_the_rows_and_the_tests_say() -> None:
    page = PAGE.read_text()
    assert page == rewritten(page), "docs/reliability.md is stale: run python tests/architecture/test_reliability.py"


@pytest.mark.fault("G12")
def test_every_row_has_either_a_test_or_a_reason_for_none() -> None:
    marked = marked_tests()
    assert {row for row, texts in ROWS.items() if (row in marked) == ("why_not" in texts)} == set()


def test_the_page_says_what_a_test_needs() -> None:
    test = "faults/test_full_disk.py::test_a_fit_is_refused_whole_and_begun_later_by_the_same_key"
    assert f"`{test}`, needs root" in marked_tests()["F9"]
    assert "`faults/test_clock_jumps.py`, needs libfaketime" in marked_tests()["C23"]


def test_every_mark_names_a_row_and_every_row_is_on_the_page() -> None:
    assert set(marked_tests()) - set(ROWS) == set()
    shown = re.findall(TABLE, PAGE.read_text())
    assert {row[0] for row in ROWS} == {letter for _, letter, *_ in shown}


@cache
def marked_tests() -> dict[str, list[str]]:
    """Returns the marked tests of each row, as `folder/file.py::test`, or the file where all its tests are marked.

    After each comes what it needs of the machine.
    """
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted(ROOT.glob("tests/**/test_*.py")):
        if "mark.fault(" not in (text := path.read_text()):
            continue
        module = ast.parse(text)
        for statement in module.body:
            test = f"::{statement.name}" if isinstance(statement, Function) else ""
            for row in marks(statement):
                needed = "".join(f", needs {each}" for each in sorted(needs(statement, module)))
                found[row].append(f"`{path.relative_to(ROOT / 'tests')}{test}`{needed}")
    return dict(found)


def marks(statement: ast.stmt) -> Iterator[str]:
    """Yields the rows that `pytest.mark.fault` names in a statement."""
    for node in ast.walk(statement):
        match node:
            case ast.Call(ast.Attribute(attr="fault"), [ast.Constant(row)]):
                yield row


def needs(test: ast.stmt, module: ast.Module) -> set[str]:
    """Returns what a test needs: X where it, or a fixture of its module that it uses, is skipped with "needs X"."""
    functions = {each.name: each for each in module.body if isinstance(each, Function)}
    autouse = [f for f in functions.values() if any("autouse" in ast.dump(each) for each in f.decorator_list)]
    used = [test, *autouse, *(each for each in module.body if isinstance(each, ast.Assign))]
    for each in used:  # grows
        names = [each.arg for each in each.args.args] if isinstance(each, Function) else []
        used += [functions[name] for name in names if name in functions and functions[name] not in used]
    texts = [node.value for each in used for node in ast.walk(each) if isinstance(node, ast.Constant)]
    return {match[1] for text in texts if (match := re.match(r"needs ([^:]+)", str(text)))}


def rewritten(page: str) -> str:
    """Returns a page with its tables made anew."""
    return TABLE.sub(lambda match: f"{match[1]}\n{table(match['letter'])}\n", page).rstrip("\n") + "\n"


def table(letter: str) -> str:
    """Returns the table of the rows that begin with a letter."""
    marked = marked_tests()
    lines = ["| row | promise | figure | tests |", "|---|---|---|---|"]
    for row, texts in ROWS.items():
        if row.startswith(letter):
            tests = texts.get("why_not") or "<br>".join(marked.get(row, ()))
            lines.append(f"| {row} | {texts['promise']} | {texts.get('figure', '')} | {tests} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text()))
