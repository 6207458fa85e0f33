"""The house rules that no linter knows."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = [
    path
    for folder in ("src/freerein", "services", "benchmarks")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "src/freerein/api" not in str(path)
]
MANIFESTS = [ROOT / "pyproject.toml", *sorted(ROOT.glob("services/*/pyproject.toml"))]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")] + sorted(ROOT.glob("docs/**/*.md"))

UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"}
UNSAFE_CALLS = {"eval", "exec", "torch.load", "torch.save", "yaml.load", "numpy.load", "np.load", "os.system"}
ROWS = (
    [f"C{i}" for i in (*range(1, 10), *range(11, 14), 15, 16, 18, 19, 20)]
    + [f"S{i}" for i in range(1, 10)]
    + [f"I{i}" for i in (1, 2, 3, 4, 5, 7, 8, 13, 14, 15, 16, 18)]
    + [f"M{i}" for i in (4, 5, 6, 7, 8, 10, 11, 13)]
    + [f"R{i}" for i in range(1, 6)]
    + [f"O{i}" for i in (1, 2, 3, *range(5, 16))]
    + ["N1"]
)


def test_all_distributions_have_one_version() -> None:
    versions = {tomllib.loads(path.read_text())["project"]["version"] for path in MANIFESTS}
    declared = re.search(r'__version__ = "(.+)"', (ROOT / "src/freerein/__init__.py").read_text())
    assert declared is not None
    assert versions == {declared[1]}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_nothing_unpickles_evaluates_or_shells_out(path: Path) -> None:
    tree = ast.parse(path.read_text())
    imported = {
        alias.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    }
    imported |= {(node.module or "").split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    called = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    keywords = {
        (k.arg, ast.unparse(k.value)) for node in ast.walk(tree) if isinstance(node, ast.Call) for k in node.keywords
    }
    assert not imported & UNSAFE_MODULES
    assert not called & UNSAFE_CALLS
    assert not keywords & {("shell", "True"), ("verify", "False"), ("allow_pickle", "True")}


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_file_is_one_idea(path: Path) -> None:
    lines = path.read_text().splitlines()
    functions = [
        n for n in ast.walk(ast.parse("\n".join(lines))) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    assert len(lines) <= 400
    assert all((function.end_lineno or 0) - function.lineno < 60 for function in functions)
    assert path.stem not in {"utils", "helpers", "base", "manager", "misc"}


@pytest.mark.parametrize("row", ROWS)
def test_a_fault_row_has_a_test(row: str) -> None:
    marked = {
        found
        for path in ROOT.glob("tests/**/test_*.py")
        for found in re.findall(r'fault\("([A-Z]\d+)"', path.read_text())
    }
    assert row in marked


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    targets = [t.partition("#")[0] for t in re.findall(r"\]\(([^)\s]+)\)", page.read_text()) if "://" not in t]
    assert [target for target in targets if target and not (page.parent / target).exists()] == []
