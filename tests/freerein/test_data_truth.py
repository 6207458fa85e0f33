"""Ground truth is for evaluation: it has a module of its own, which the learner's reader cannot reach."""

import ast
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import freerein.data
from freerein.data import Dataset, DatasetSpec, create, inspect, truth, verify
from freerein.errors import NotFound
from freerein.types.common import ActionSpec, Trajectory

PACKAGE = Path(freerein.data.__file__).parent
LEARNER = """
import sys
from pathlib import Path

from freerein.data import Dataset

touched = []
WATCHED = {"open", "os.listdir", "os.scandir", "os.rename", "os.remove"}
sys.addaudithook(lambda event, arguments: touched.append(str(arguments[0])) if event in WATCHED else None)
dataset = Dataset(Path(sys.argv[1]))
list(dataset), dataset.actions(0), dataset.fingerprint, dataset.cached_frames("front")[0], dataset.cached_actions()[0]
print("\\n".join(touched))
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    spec = DatasetSpec(
        fps=10,
        cameras={"front": (6, 8, 3)},
        action=ActionSpec(size=2, choices=0, names=("x", "y")),
        robot_type="arm",
        skills=("pick", "push"),
        has_terminations=True,
    )
    each = Trajectory(
        {"front": np.zeros((4, 6, 8, 3), np.uint8)},
        np.zeros((4, 2), np.float32),
        ("pick", "push"),
        terminated=np.array([False, False, False, True]),
    )
    with create(tmp_path / "demos", spec) as writer:
        writer.append(each, np.array([1, 1, 0, 0]))
        writer.append(each)
    return tmp_path / "demos"


def imported_from_package(module: str) -> set[str]:
    """Returns the modules of freerein.data that a module of it imports."""
    tree = ast.parse((PACKAGE / f"{module}.py").read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    direct = {node.module.rpartition(".")[2] for node in imports if (node.module or "").startswith("freerein.data.")}
    return direct | {name.name for node in imports if node.module == "freerein.data" for name in node.names}


def test_labels_come_back(root: Path) -> None:
    assert truth.labels(root, 0).dtype == np.int64
    assert truth.labels(root, 0).tolist() == [1, 1, 0, 0]
    assert truth.labelled(root) == [0]


def test_labels_of_a_trajectory_that_a_killed_recording_never_wrote_are_not_read(root: Path) -> None:
    truth.save(root, 2, np.array([0, 0, 1]))
    assert (truth.labelled(root), truth.stored(root)) == ([0], [0, 2])
    assert inspect(root).labelled == 1
    assert [problem.where for problem in verify(root)] == ["truth/chunk-000/file-002.parquet"]


def test_labels_that_were_not_recorded_are_not_found(root: Path) -> None:
    for index in (1, 2):
        with pytest.raises(NotFound):
            truth.labels(root, index)


def test_the_learners_reader_imports_nothing_that_knows_of_truth() -> None:
    reached, pending = set(), {"reader"}
    while pending:
        reached |= pending
        pending = set().union(*(imported_from_package(module) for module in pending)) - reached

    assert {"reader", "trajectory_file", "meta", "layout", "lerobot", "cache"} <= reached
    assert "truth" not in reached
    constants = [
        node.value
        for module in reached
        for node in ast.walk(ast.parse((PACKAGE / f"{module}.py").read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert "truth" not in constants


def test_the_learners_reader_opens_nothing_below_truth(root: Path, fork_program: Callable[..., Any]) -> None:
    for stale in (root / "meta").rglob("*.json"):
        stale.unlink()  # so that the reader also walks the paths that rebuild meta

    learner = fork_program("tests.code", LEARNER, root)

    touched = learner.stdout.read().splitlines()
    assert learner.process.wait() == 0
    assert any(path.endswith("data/chunk-000/file-000.parquet") for path in touched)
    assert any(path.endswith("meta/info.json.tmp") for path in touched)
    assert not [path for path in touched if path.startswith(f"{root}/truth")]


def test_skill_cloning_alone_reads_a_robots_own_state_and_no_world_or_experiment_has_one() -> None:
    """It is for robots of users; in a simulated world it would be privileged, and no claim rests on it."""
    repository = Path(__file__).parents[2]
    imitation = repository / "services/imitation/freerein_imitation"
    folders = ("services", "experiments", *(f"src/freerein/{name}" for name in ("learning", "envs", "serving")))
    files = {each: each.read_text() for folder in folders for each in (repository / folder).rglob("*.py")}
    assert len(files) > 100
    knowing = {each for each, text in files.items() if re.search(r"robot_state|STATE_KEY|observation\.state", text)}
    method = imitation / "methods/skill_cloning"
    learning = {each.parent for each in knowing if each.is_relative_to(imitation / "methods")}
    assert learning == {method}
    assert {each for each in knowing if not each.is_relative_to(imitation)} == set()
    assert [each for each, text in files.items() if "dataset.robot_state(" in text] == [method / "method.py"]
    assert not any("state" in field.name for field in fields(Trajectory))
    observations = [
        call
        for each, text in files.items()
        if "Observation(" in text and not each.is_relative_to(imitation)
        for call in ast.walk(ast.parse(text))
        if isinstance(call, ast.Call) and ast.unparse(call.func) == "Observation"
    ]
    assert observations
    assert all(len(call.args) <= 1 and not call.keywords for call in observations)


def test_garbage_in_truth_changes_nothing_that_learners_see(root: Path) -> None:
    before = Dataset(root)
    for path in (root / "truth").rglob("*.parquet"):
        path.write_bytes(b"garbage")
    (root / "truth" / "data").mkdir()

    after = Dataset(root)

    assert after.fingerprint == before.fingerprint
    assert [each.skills for each in after] == [each.skills for each in before]
