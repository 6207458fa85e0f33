"""The hash of a task's generator: of everything that decides its starts, looks, demonstrations and labels.

What it draws cannot be hashed: pixels differ between OpenGL drivers, and the last bits of a simulation between CPUs,
which contacts amplify. So its sources are hashed, which are equal on all machines, as syntax trees (decision 26):

- the module of the world, and all modules of its package and of `freerein_sim.worlds` that it imports, but for those
  that declare, check or judge;
- how episodes are recorded and recipes are drawn;
- the versions of the simulator, and of the wheels whose files it reads;
- the streams of numpy's generators.
"""

import ast
import hashlib
import importlib.util
import threading
from collections.abc import Iterator
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from freerein.errors import FailedPrecondition
from freerein_sim.worlds.syntax_text import syntax_text
from freerein_sim.worlds.world import TaskDefinition

_WORLDS = "freerein_sim.worlds"
_RECORDING = f"{_WORLDS}.episodes"
_DRAW_NOTHING = frozenset(f"{_WORLDS}.{name}" for name in ("world", "conditions", "opengl", "predicates", "tasks"))
"""Shared modules that declare, check or judge."""

_SIMULATORS = ("mujoco",)
_READS_FILES = "asset_folder"

_parsing = threading.Lock()
"""Python's parser, before 3.11.5, is not safe to call on several threads at once."""


def generator_hash(task: TaskDefinition) -> str:
    """Returns the sha256 of a task's generator; comments, docstrings, imports and texts of errors do not matter.

    Raises:
        FailedPrecondition: A wheel that the world reads is not installed.
    """
    digest = hashlib.sha256(f"{task.name} {_streams()}".encode())
    wheels: set[str] = set()
    for name, tree in sorted(_modules(task).items()):
        wheels |= _wheels(tree)
        digest.update(f"{name} {syntax_text(_Bare().visit(tree))}".encode())
    for wheel in sorted(wheels):
        digest.update(f"{wheel} {_version(wheel)}".encode())
    return digest.hexdigest()


def _modules(task: TaskDefinition) -> dict[str, ast.Module]:
    """Returns the syntax trees of the task's modules, by name."""
    made_in = _module_of(task.make)
    roots = (_WORLDS, made_in.partition(".")[0])
    found: dict[str, ast.Module] = {}
    waiting = [made_in, type(task.recipes).__module__, _RECORDING]
    while waiting:
        name = waiting.pop()
        if name in found or name in _DRAW_NOTHING or not name.startswith(tuple(f"{root}." for root in roots) + roots):
            continue
        if (source := _source(name)) is not None:
            with _parsing:
                found[name] = tree = ast.parse(source)
            waiting += _imports(tree)
    return found


def _module_of(make: Any) -> str:
    while isinstance(make, partial):
        make = make.func
    return str(make.__module__)


def _source(module: str) -> str | None:
    """Returns the source of a module; None where the name is that of something in a module."""
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin).read_text() if spec is not None and spec.origin is not None else None


def _imports(tree: ast.Module) -> Iterator[str]:
    """Yields what a module imports: modules, and names that may be modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _wheels(tree: ast.Module) -> set[str]:
    """Returns the simulators that a module imports, and the packages whose files it reads."""
    read = {
        str(node.args[0].value).replace("_", "-")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == _READS_FILES
        if isinstance(node.args[0], ast.Constant)
    }
    return read | {name for name in _SIMULATORS if name in _imports(tree)}


def _version(wheel: str) -> str:
    try:
        return version(wheel)
    except PackageNotFoundError:
        raise FailedPrecondition(
            f"The hash of this world needs the wheel {wheel}, which is not installed.",
            hint="pip install --no-deps -r assets.txt -r assets-robots.txt",
        ) from None


def _streams() -> str:
    """Returns what numpy's generators draw, as far as it is the same on all machines."""
    rng = np.random.default_rng(0)
    return f"{rng.integers(1000)} {rng.permutation(9)} {rng.choice(9)} {rng.random():.9f} {rng.standard_normal():.9f}"


class _Bare(ast.NodeTransformer):
    """Removes docstrings, imports and what is raised."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node

    def visit_Raise(self, _node: ast.Raise) -> ast.Raise:
        return ast.Raise()

    def visit_Import(self, _node: ast.Import) -> None:
        return None

    def visit_ImportFrom(self, _node: ast.ImportFrom) -> None:
        return None
