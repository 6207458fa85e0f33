"""Datasets of other tools: LeRobotDataset v3 written here with pyarrow alone, several trajectories to a file."""

import itertools
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from freerein import images
from freerein.data import Dataset, LeRobotSource, StepCache, check, import_trajectories, open_writer, verify
from freerein.errors import InvalidInput, NotFound
from freerein.learning.fit_dataset import FitDataset
from freerein.learning.trajectories import Trajectories

LENGTHS = (2, 3, 4)
PIXELS = np.random.default_rng(0).integers(0, 256, (sum(LENGTHS), 6, 8, 3), dtype=np.uint8)
ACTIONS = np.random.default_rng(1).uniform(-3, 3, (sum(LENGTHS), 2)).astype(np.float32)
STATES = np.random.default_rng(2).normal(size=(sum(LENGTHS), 2)).astype(np.float32)
COUNTER = {"dtype": "int64", "shape": [1], "names": None}
INFO: dict[str, Any] = {
    "codebase_version": "v3.0",
    "robot_type": None,
    "total_episodes": 3,
    "total_frames": 9,
    "total_tasks": 1,
    "fps": 10,
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "features": {
        "observation.image": {"dtype": "image", "shape": [3, 6, 8], "names": ["channel", "height", "width"]},
        "observation.state": {"dtype": "float32", "shape": [2], "names": {"motors": ["pan", "lift"]}},
        "action": {"dtype": "float32", "shape": [2], "names": {"motors": ["pan", "lift"]}},
        "episode_index": COUNTER,
    },
}


def write_info(root: Path, **changes: object) -> None:
    (root / "meta/info.json").write_text(json.dumps(INFO | changes))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Trajectories 0 and 1 share a file and a row group; trajectory 2 has a file of its own."""
    for folder in ("data/chunk-000", "meta/episodes/chunk-000"):
        (tmp_path / folder).mkdir(parents=True)
    episode_of = np.repeat(np.arange(3), LENGTHS)
    table = pa.table(
        {
            "observation.image": [{"bytes": images.encode(pixels).data, "path": None} for pixels in PIXELS],
            "observation.state": pa.array(STATES.tolist(), pa.list_(pa.float32())),
            "action": pa.array(ACTIONS.tolist(), pa.list_(pa.float32())),
            "episode_index": episode_of,
        }
    )
    pq.write_table(table.slice(0, 5), tmp_path / "data/chunk-000/file-000.parquet")
    pq.write_table(table.slice(5), tmp_path / "data/chunk-000/file-001.parquet")
    episodes = {
        "episode_index": [0, 1, 2],
        "length": LENGTHS,
        "data/chunk_index": [0] * 3,
        "data/file_index": [0, 0, 1],
    }
    pq.write_table(pa.table(episodes), tmp_path / "meta/episodes/chunk-000/file-000.parquet")
    pq.write_table(pa.table({"task_index": [0], "task": ["lift it"]}), tmp_path / "meta/tasks.parquet")
    (tmp_path / "meta/stats.json").write_text(json.dumps({"action": {"max": [4]}}))
    write_info(tmp_path)
    return tmp_path


def test_every_trajectory_of_a_shared_file_is_read(root: Path) -> None:
    dataset = Dataset(root)

    assert (dataset.spec.cameras, dataset.spec.task) == ({"image": (6, 8, 3)}, "lift it")
    assert (dataset.spec.action.size, dataset.spec.action.names) == (2, ("pan", "lift"))
    assert dataset.goal_texts == ("lift it",) * 3
    for index, (start, end) in enumerate([(0, 2), (2, 5), (5, 9)]):
        np.testing.assert_array_equal(dataset[index].frames["image"], PIXELS[start:end])
        np.testing.assert_array_equal(dataset[index].actions, ACTIONS[start:end])
        np.testing.assert_array_equal(dataset.cached_frames("image")[index], PIXELS[start:end])
        assert dataset[index].skills == ()
    assert verify(root) == []


def test_the_robots_own_state_is_kept_beside_what_learners_read(root: Path, tmp_path: Path) -> None:
    import_trajectories(LeRobotSource(root), tmp_path / "imported")
    for dataset in (Dataset(root), Dataset(tmp_path / "imported")):
        assert (dataset.spec.robot_state_size, dataset.spec.robot_state_names) == (2, ("pan", "lift"))
        np.testing.assert_array_equal(np.concatenate([dataset.robot_state(index) for index in range(3)]), STATES)
    assert verify(tmp_path / "imported") == []


def test_learners_read_the_same_with_and_without_a_state_of_the_robot(root: Path, tmp_path: Path) -> None:
    import_trajectories(LeRobotSource(root), tmp_path / "with")
    write_info(root, features={key: each for key, each in INFO["features"].items() if key != "observation.state"})
    import_trajectories(LeRobotSource(root), tmp_path / "without")
    read = [
        FitDataset(path, Dataset(path)).trajectories(["image"], any_unit=True)
        for path in (tmp_path / "with", tmp_path / "without")
    ]
    for name in (field.name for field in fields(Trajectories)):
        first, second = (getattr(each, name) for each in read)
        np.testing.assert_equal(unpacked(first), unpacked(second))
    assert [Dataset(tmp_path / each).spec.robot_state_size for each in ("with", "without")] == [2, 0]


def unpacked(values: Any) -> Any:
    """Returns arrays of trajectories as plain arrays."""
    if isinstance(values, Mapping):
        return {name: unpacked(each) for name, each in values.items()}
    return values.steps if isinstance(values, StepCache) else values


def test_a_state_that_is_no_vector_of_floats_is_left_out(root: Path) -> None:
    for feature in ({"dtype": "int64", "shape": [2]}, {"dtype": "float32", "shape": [2, 2]}):
        write_info(root, features=INFO["features"] | {"observation.state": {**feature, "names": None}})
        assert Dataset(root).spec.robot_state_size == 0
        assert Dataset(root).robot_state(0) is None


def test_a_state_of_another_size_than_declared_is_found(root: Path) -> None:
    state = {"dtype": "float32", "shape": [3], "names": None}
    write_info(root, features=INFO["features"] | {"observation.state": state})
    assert [each.where for each in verify(root)] == ["trajectory 0", "trajectory 1", "trajectory 2"]


def test_names_of_cameras_become_names_of_ours(root: Path) -> None:
    features = {("observation.images.Front" if "image" in key else key): each for key, each in INFO["features"].items()}
    write_info(root, features=features)
    assert list(Dataset(root).spec.cameras) == ["front"]


def test_nothing_but_the_cache_is_written_into_it(root: Path) -> None:
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    Dataset(root).cached_actions()
    after = {path: path.read_bytes() for path in root.rglob("*") if path.is_file() and "cache" not in path.parts}
    assert after == before
    with pytest.raises(NotFound):
        open_writer(root)


def test_skills_are_read_where_episodes_have_them(root: Path) -> None:
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path).append_column("skills", [[["push"], None, ["pick", "push"]]]), path)
    assert Dataset(root).skills == (("push",), (), ("pick", "push"))
    assert Dataset(root).spec.skills == ("pick", "push")


def test_goal_texts_are_read_where_episodes_name_one_task(root: Path) -> None:
    pq.write_table(pa.table({"task_index": [0, 1], "task": ["lift it", "drop it"]}), root / "meta/tasks.parquet")
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(path).append_column("tasks", [[["drop it"], ["lift it", "drop it"], None]]), path)
    assert (Dataset(root).spec.task, Dataset(root).goal_texts) == ("", ("drop it", "", ""))


def test_a_task_may_be_text_in_any_of_arrows_ways(root: Path) -> None:
    texts = (pa.string(), pa.large_string(), pa.string_view(), pa.dictionary(pa.int32(), pa.string()))
    for kind, name in itertools.product(texts, ("task", "__index_level_0__")):
        tasks = pa.table({"task_index": [0], name: pa.array(["pour"]).cast(kind)})
        pq.write_table(tasks, root / "meta/tasks.parquet")
        assert Dataset(root).spec.task == "pour"


def test_tasks_and_skills_of_episodes_may_be_lists_of_any_kind(root: Path) -> None:
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    episodes = pq.read_table(path)
    for kind in (pa.list_(pa.large_string()), pa.large_list(pa.string())):
        lists = pa.array([["pour"], [], None], kind)
        pq.write_table(episodes.append_column("tasks", lists).append_column("skills", lists), path)
        assert Dataset(root).goal_texts == ("pour", "lift it", "lift it")
        assert Dataset(root).skills == (("pour",), (), ())


def test_tasks_without_a_text_are_refused(root: Path) -> None:
    columns: dict[str, list[Any]]
    for columns in ({}, {"task": [7]}, {"task": [["lift"]], "note": ["lift"]}):
        pq.write_table(pa.table({"task_index": [0], **columns}), root / "meta/tasks.parquet")
        with pytest.raises(InvalidInput, match="in a column `task`; it has no such texts"):
            Dataset(root)


def add_bools(root: Path, columns: dict[str, list[bool | None]], *, listed: bool = False) -> None:
    """Adds columns to every data file, and declares them."""
    for path in sorted((root / "data").rglob("*.parquet")):
        table = pq.read_table(path)
        for name, values in columns.items():
            own, columns[name] = values[: len(table)], values[len(table) :]
            table = table.append_column(name, [[[value] for value in own]] if listed else [own])
        pq.write_table(table, path)
    bools = {name: {"dtype": "bool", "shape": [1], "names": None} for name in columns}
    write_info(root, features=INFO["features"] | bools)


@pytest.mark.parametrize("listed", [False, True])
def test_terminations_are_read_where_there_is_next_done(root: Path, listed: bool) -> None:
    ends = [False, True, False, False, True, False, False, False, False]
    add_bools(root, {"next.done": list(ends)}, listed=listed)
    dataset = Dataset(root)
    assert dataset.spec.has_terminations
    assert [each.terminated.tolist() for each in dataset] == [ends[:2], ends[2:5], ends[5:]]
    assert verify(root) == []


def test_a_column_of_terminations_comes_before_next_done(root: Path) -> None:
    add_bools(root, {"next.done": [True] * 9, "next.terminated": [False] * 9})
    assert not any(each.terminated.any() for each in Dataset(root))


def test_terminations_are_unknown_where_there_is_no_bool_of_them(root: Path) -> None:
    write_info(root, features=INFO["features"] | {"next.done": COUNTER})
    assert Dataset(root)[0].terminated is None


def test_terminations_that_are_declared_but_not_stored_are_found(root: Path) -> None:
    write_info(root, features=INFO["features"] | {"next.done": {"dtype": "bool", "shape": [1], "names": None}})
    assert [each.where for each in verify(root)] == ["trajectory 0", "trajectory 1", "trajectory 2"]


def test_a_termination_without_a_value_is_found(root: Path) -> None:
    add_bools(root, {"next.done": [True, None, *[False] * 7]})
    assert [each.where for each in verify(root)] == ["trajectory 0"]


def test_discrete_actions_take_their_number_of_choices_from_the_statistics(root: Path) -> None:
    for path in (root / "data").rglob("*.parquet"):
        table = pq.read_table(path)
        column = table.column_names.index("action")
        pq.write_table(table.set_column(column, "action", pa.array(np.arange(len(table)), pa.int64())), path)
    write_info(root, features=INFO["features"] | {"action": COUNTER})

    dataset = Dataset(root)

    assert dataset.spec.action.choices == 5
    assert dataset[1].actions.tolist() == [[2], [3], [4]]


def test_what_cannot_be_read_here_is_refused_with_a_reason(root: Path) -> None:
    changes: dict[str, Any]
    for changes, word in (
        ({"codebase_version": "v2.1"}, "version"),
        ({"fps": 29.97}, "fps"),
        ({"data_path": "../../{chunk_index}.parquet"}, "path"),
        ({"features": INFO["features"] | {"action": {"dtype": "string", "shape": [1], "names": None}}}, "action"),
        ({"features": {"action": INFO["features"]["action"]}}, "camera"),
        ({"features": {}}, "camera"),
        ({"features": None}, "camera"),
    ):
        write_info(root, **changes)
        with pytest.raises(InvalidInput, match=word):
            Dataset(root)


def test_a_damaged_file_is_found(root: Path) -> None:
    path = root / "data/chunk-000/file-000.parquet"
    path.write_bytes(path.read_bytes()[:100])
    assert [each.where for each in verify(root)] == ["trajectory 0", "trajectory 1"]
    path.unlink()
    assert [each.where for each in verify(root)] == ["trajectory 0", "trajectory 1"]


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_an_error_of_check_and_of_a_fit_in_any_unit(root: Path, number: float) -> None:
    path = root / "data/chunk-000/file-001.parquet"
    table = pq.read_table(path)
    broken = ACTIONS[5:].copy()
    broken[2, 1] = number
    column = table.column_names.index("action")
    pq.write_table(table.set_column(column, "action", pa.array(broken.tolist(), pa.list_(pa.float32()))), path)

    errors = [each for each in check(root) if each.where == "trajectory 2"]

    assert [(each.severity, "1 of 8 numbers are not" in each.sentence) for each in errors] == [("error", True)]
    with pytest.raises(InvalidInput, match="Actions must be finite"):
        FitDataset(root, Dataset(root)).trajectories(["image"], any_unit=True)


def test_a_trajectory_without_a_timestep_is_an_error_of_check_and_of_a_fit(root: Path) -> None:
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    pq.write_table(table.set_column(1, "length", pa.array([2, 3, 0])), path)
    pq.write_table(
        pq.read_table(root / "data/chunk-000/file-001.parquet").slice(0, 0), root / "data/chunk-000/file-001.parquet"
    )
    assert [(each.where, each.severity) for each in check(root) if "timestep" in each.sentence] == [
        ("trajectory 2", "error")
    ]
    with pytest.raises(InvalidInput, match="1 have none, such as 2"):
        FitDataset(root, Dataset(root)).trajectories(["image"], any_unit=True)
