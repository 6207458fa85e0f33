"""Rules of the house style that no linter checks."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = [
    path
    for folder in ("src/freerein", "services", "benchmarks", "experiments", "mutants", "soak")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "src/freerein/api" not in str(path)
]
MANIFESTS = [ROOT / "pyproject.toml", ROOT / "src/pyproject.toml", *sorted(ROOT.glob("services/*/pyproject.toml"))]
NAMED_PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "experiments/README.md")
PAGES = [ROOT / name for name in NAMED_PAGES] + sorted(ROOT.glob("docs/**/*.md"))

UNSAFE_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"}
UNSAFE_CALLS = {"eval", "exec", "torch.load", "torch.save", "yaml.load", "numpy.load", "np.load", "os.system"}


def test_all_distributions_have_one_version() -> None:
    versions = {tomllib.loads(path.read_text())["project"]["version"] for path in MANIFESTS}
    declared = re.search(r'__version__ = "(.+)"', (ROOT / "src/freerein/__init__.py").read_text())
    assert declared is not None
    assert versions == {declared[1]}


@pytest.mark.fault("D2")
def test_nothing_unpickles_evaluates_or_shells_out_and_a_file_is_one_idea() -> None:
    for path in SOURCES:
        check(path)


def check(path: Path) -> None:
    text = path.read_text()
    nodes = list(ast.walk(ast.parse(text)))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    keywords = {(keyword.arg, ast.unparse(keyword.value)) for call in calls for keyword in call.keywords}
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    assert not {name.split(".")[0] for name in imported} & UNSAFE_MODULES, path
    assert not {ast.unparse(call.func) for call in calls} & UNSAFE_CALLS, path
    assert not keywords & {("shell", "True"), ("verify", "False"), ("allow_pickle", "True")}, path
    assert len(text.splitlines()) <= 400, path
    assert all((function.end_lineno or 0) - function.lineno < 60 for function in functions), path
    assert path.stem not in {"utils", "helpers", "base", "manager", "misc"}


def test_every_relative_link_leads_somewhere() -> None:
    links = [(page, link) for page in PAGES for link in re.findall(r"\]\(([^)\s#]+)", page.read_text())]
    assert [(page, link) for page, link in links if "://" not in link and not (page.parent / link).exists()] == []
