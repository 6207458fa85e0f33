import ast
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path

import pytest

from freerein.errors import FailedPrecondition
from freerein_sim.worlds.generator_hash import generator_hash
from freerein_sim.worlds.syntax_text import syntax_text
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.world import TaskDefinition

SOURCES = {
    "__init__": """
'''A world.'''

def make():
    from {package} import simulation

    return simulation.World()
""",
    "simulation": """
from freerein_sim.worlds.mujoco_world import asset_folder
from {package}.starts import START

class World:
    folder = asset_folder("gymnasium")
    start = START
""",
    "starts": "START = 3\n\ndef check():\n    raise ValueError('too far')\n",
}
CHANGES = {
    "nothing": ("starts", "START = 3", "START = 3", True),
    "a comment": ("starts", "START = 3", "START = 3  # metres", True),
    "a docstring": ("__init__", "A world.", "Another docstring.", True),
    "an error": ("starts", "too far", "farther than 3", True),
    "a start": ("starts", "START = 3", "START = 4", False),
    "a wheel": ("simulation", '"gymnasium"', '"gymnasium_robotics"', False),
}
NAMES = ("grid", "grid-no-indicator", "blocks", "blocks.scatter", "pendulum", "tabletop", "tabletop.only-own-objects")


@pytest.fixture
def made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., TaskDefinition]:
    """A function that returns a task of the package that some sources make."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(sources: dict[str, str]) -> TaskDefinition:
        package = tmp_path.name  # of each test another, since Python keeps what it has imported
        folder = tmp_path / package
        folder.mkdir()
        for module, source in sources.items():
            (folder / f"{module}.py").write_text(source.replace("{package}", package))
        make = import_module(package).make
        return TaskDefinition("sketch", "sketch", "", tasks()["grid"].spec, partial(make))

    return write


@pytest.mark.parametrize(("module", "before", "after", "same"), CHANGES.values(), ids=list(CHANGES))
def test_the_hash_changes_with_what_is_drawn_and_only_then(
    made_of: Callable[..., TaskDefinition], tmp_path: Path, module: str, before: str, after: str, same: bool
) -> None:
    task = made_of(SOURCES)
    first = generator_hash(task)
    path = tmp_path / tmp_path.name / f"{module}.py"
    source = path.read_text()
    assert before in source
    path.write_text(source.replace(before, after))

    assert (generator_hash(task) == first) is same


def test_a_wheel_that_is_missing_is_named(made_of: Callable[..., TaskDefinition]) -> None:
    missing = {**SOURCES, "simulation": SOURCES["simulation"].replace("gymnasium", "no_such_wheel")}
    with pytest.raises(FailedPrecondition, match="no-such-wheel"):
        generator_hash(made_of(missing))


def test_syntax_has_the_text_that_it_has_in_python_3_11() -> None:
    source = "class A(B):\n    def f(x=None, *y) -> None:\n        return f'a{x:>{y}}', ''"
    written = (
        "Module(body=[ClassDef(name='A', bases=[Name(id='B', ctx=Load())], keywords=[], body=[FunctionDef(name='f', "
        "args=arguments(posonlyargs=[], args=[arg(arg='x')], vararg=arg(arg='y'), kwonlyargs=[], kw_defaults=[], "
        "defaults=[Constant(value=None)]), body=[Return(value=Tuple(elts=[JoinedStr(values=[Constant(value='a'), "
        "FormattedValue(value=Name(id='x', ctx=Load()), conversion=-1, format_spec=JoinedStr(values=["
        "Constant(value='>'), FormattedValue(value=Name(id='y', ctx=Load()), conversion=-1)]))]), "
        "Constant(value='')], ctx=Load()))], decorator_list=[], returns=Constant(value=None))], decorator_list=[])], "
        "type_ignores=[])"
    )
    assert syntax_text(ast.parse(source)) == written
    if sys.version_info < (3, 12):
        assert ast.dump(ast.parse(source)) == written


def test_each_task_has_a_hash_of_its_own_that_another_process_finds_again() -> None:
    script = (
        "import sys\n"
        "from freerein_sim.worlds.generator_hash import generator_hash\n"
        "from freerein_sim.worlds.tasks import tasks\n"
        "print(*(generator_hash(tasks()[name]) for name in sys.argv[1:]))"
    )
    environ = {**os.environ, "PYTHONHASHSEED": "1", "MUJOCO_GL": "osmesa"}
    run = subprocess.run(
        [sys.executable, "-c", script, *NAMES], env=environ, capture_output=True, text=True, check=True
    )

    hashes = [generator_hash(tasks()[name]) for name in NAMES]

    assert run.stdout.split() == hashes
    assert len(set(hashes)) == len(hashes)
