"""Damaged and hostile files of LeRobot's datasets: refused by name, like a request, or left out where that is asked."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import (
    DATA,
    EPISODES,
    INFO,
    STEPS,
    rows_of,
    write_data,
    write_dataset,
    write_episodes,
    write_info,
)
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, LeRobotOptions, LeRobotSource, import_trajectories, labels, verify
from freerein.errors import InvalidInput, ServiceError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Each episode in a file of its own."""
    root = write_dataset(tmp_path / "theirs")
    write_data(root, [0], [1], [2])
    write_episodes(root, **{"data/file_index": [0, 1, 2]})
    return root


def cut(path: Path) -> None:
    """Leaves a parquet file as an interrupted recorder does: without a footer."""
    path.write_bytes(path.read_bytes()[:-300])


def change(path: Path, name: str, values: pa.Array) -> None:
    table = pq.read_table(path)
    pq.write_table(table.set_column(table.column_names.index(name), name, values), path)


FRAMES = "observation.images.top"


@pytest.mark.parametrize(
    "damage",
    [
        cut,
        Path.unlink,
        lambda path: path.write_bytes(b""),
        lambda path: change(
            path, FRAMES, pa.array([*rows_of(1)[FRAMES][:-1], {"bytes": b"\x89PNG no image", "path": None}])
        ),
        lambda path: change(path, FRAMES, pa.array(["file.png"] * STEPS)),
        lambda path: change(path, FRAMES, pa.array([{"bytes": None, "path": "file.png"}] * STEPS)),
        lambda path: change(path, "action", pa.array([[np.inf, 0.0]] * STEPS, pa.list_(pa.float32()))),
        lambda path: change(path, "action", pa.array([[0.0]] * STEPS, pa.list_(pa.float32()))),
        lambda path: pq.write_table(pa.table(rows_of(1)).slice(0, 4), path),
    ],
)
def test_errors_name_the_trajectory_and_what_is_whole_is_imported_and_the_rest_counted(
    root: Path, tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    damage(root / DATA.format(1))
    with pytest.raises(ServiceError, match=r"^Trajectory 1\b"):
        import_trajectories(LeRobotSource(root), tmp_path / "ours")
    assert not (tmp_path / "ours").exists()
    source = LeRobotSource(root, options=LeRobotOptions(skip_damaged=True))
    import_trajectories(source, tmp_path / "ours")
    assert [each.actions[0, 0] for each in Dataset(tmp_path / "ours")] == [0, 2]
    assert verify(tmp_path / "ours") == []
    assert source.notes[0] == "1 of 3 trajectories are damaged and left out:"
    assert source.notes[1].startswith("Trajectory 1")


def test_an_unfinished_file_of_episodes_is_left_out_with_its_episodes(root: Path, tmp_path: Path) -> None:
    second = root / EPISODES.replace("file-000", "file-001")
    second.write_bytes((root / EPISODES).read_bytes())
    cut(second)
    with pytest.raises(InvalidInput, match=r"`meta/episodes/chunk-000/file-001\.parquet` must be a whole file"):
        LeRobotSource(root)
    source = LeRobotSource(root, options=LeRobotOptions(skip_damaged=True))
    assert "file-001.parquet` is left out: damaged" in source.notes[0]
    import_trajectories(source, tmp_path / "ours")
    assert len(Dataset(tmp_path / "ours")) == 3


def test_nothing_is_imported_where_nothing_is_whole(root: Path, tmp_path: Path) -> None:
    for number in range(3):
        cut(root / DATA.format(number))
    with pytest.raises(InvalidInput):
        import_trajectories(LeRobotSource(root, options=LeRobotOptions(skip_damaged=True)), tmp_path / "ours")
    assert not (tmp_path / "ours").exists()


def test_verify_takes_a_folder_and_names_its_files(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    cut(root / DATA.format(1))
    monkeypatch.chdir(tmp_path)
    for name in (str(root), "./theirs", "theirs"):
        result = CliRunner().invoke(app, ["dataset", "verify", name, "--json"])
        (problem,) = json.loads(result.stdout)["problems"]
        assert (result.exit_code, problem["where"]) == (1, "trajectory 1")
        assert "`data/chunk-000/file-001.parquet`" in problem["sentence"]
    assert CliRunner().invoke(app, ["dataset", "verify", "nothing"]).exit_code == 1


def test_the_command_counts_what_it_skips(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    cut(root / DATA.format(1))
    result = CliRunner().invoke(app, ["dataset", "import", str(root), "ours", "--skip-damaged", "--json"])
    document = json.loads(result.stdout)
    assert (result.exit_code, document["imported"]) == (0, 2)
    assert document["notes"][0] == "1 of 3 trajectories are damaged and left out:"
    refused = CliRunner().invoke(app, ["dataset", "import", str(tmp_path), "other", "--skip-damaged"])
    assert (refused.exit_code, "layout lerobot" in refused.stderr) == (1, True)


def info_with(**changes: Any) -> str:
    return json.dumps(INFO | changes)


def test_a_description_is_parsed_like_a_request(root: Path) -> None:
    for text in (
        info_with(fps=10).replace(": 10", ": 1e400"),
        info_with(fps=10).replace(": 10", ": Infinity"),
        info_with(fps=10).replace(": 10", ": NaN"),
        info_with(fps=-1),
        info_with(fps=0),
        info_with(fps=10**30),
        info_with(fps="10"),
        info_with(fps=True),
        info_with(fps=None),
        "[" * 200_000,
        '{"a":' * 100_000,
        "9" * 5000,
        "[]",
        "null",
        '"v3.0"',
        "\udcff",
        "",
        info_with(features=[]),
        info_with(features={"observation.images.top": 7}),
        info_with(features=INFO["features"] | {"action": {"dtype": "float32", "shape": [10**12], "names": None}}),
        info_with(features=INFO["features"] | {"action": {"dtype": ["float32"], "shape": [2]}}),
        info_with(features=INFO["features"] | {"action": {"dtype": "float32", "shape": {"a": 1}}}),
        info_with(features=INFO["features"] | {"action": {}}),
        info_with(codebase_version=3),
        info_with(data_path=["data"]),
        info_with(robot_type="a" * 70_000_000),
    ):
        (root / "meta/info.json").write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(InvalidInput):
            Dataset(root)


def test_statistics_are_parsed_like_a_request_and_those_of_other_features_may_be_infinite(root: Path) -> None:
    write_info(root, features=INFO["features"] | {"action": {"dtype": "int64", "shape": [1], "names": None}})
    for largest in ("Infinity", "NaN", "-1", "1e400", "0.5", "1e18", "null", "[]", '"a"', "[" * 100_000, "true, {"):
        (root / "meta/stats.json").write_text(f'{{"action": {{"max": [{largest}]}}}}')
        with pytest.raises(InvalidInput, match=r"stats\.json"):
            Dataset(root)
    (root / "meta/stats.json").write_text(
        '{"action": {"max": [4]}, "next.reward": {"min": [-Infinity], "mean": [NaN]}}'
    )
    assert Dataset(root).spec.action.choices == 5


def test_a_table_of_episodes_is_parsed_like_a_request(root: Path) -> None:
    changes: dict[str, Any]
    for changes in (
        {"length": [5, None, 5]},
        {"length": [5, -5, 5]},
        {"length": [5, 2**62, 5]},
        {"length": pa.array([5.0, 5.5, 5.0])},
        {"length": [[5]] * 3},
        {"length": ["5", "x", "5"]},
        {"episode_index": [0, None, 2]},
        {"episode_index": [0, -1, 2]},
        {"data/file_index": [0, None, 2]},
        {"data/chunk_index": [0, 10**15, 0]},
        {"tasks": [1, 2, 3]},
        {"skills": [[""], ["a"], ["b"]]},
    ):
        write_episodes(root, **changes)
        with pytest.raises(InvalidInput):
            Dataset(root)


@pytest.mark.parametrize("name", ["meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet"])
def test_a_table_of_too_many_rows_is_refused_before_it_is_read(root: Path, name: str) -> None:
    path = root / name
    columns = {each: pa.nulls(10_000_001, pa.int8()) for each in pq.read_table(path).column_names}
    pq.write_table(pa.table(columns), path, row_group_size=10_000_001)
    with pytest.raises(InvalidInput, match="must be a whole file"):
        Dataset(root)


@pytest.mark.parametrize("name", ["tags.json", "meta/freerein.json"])
def test_files_of_ours_that_others_changed_are_parsed_like_a_request(root: Path, name: str) -> None:
    for text in ("[" * 200_000, '{"fps": 1e400, "skills": [], "by_trajectory": {"1e400": []}}', "null"):
        (root / name).write_text(text)
        with pytest.raises(InvalidInput):
            Dataset(root)


@pytest.mark.parametrize("name", ["action", "episode_index", "frame_index"])
def test_columns_of_another_kind_are_refused(root: Path, name: str) -> None:
    path = root / DATA.format(1)
    whole = path.read_bytes()
    for value in (None, "x", b"x", float("nan"), [], [[0.0]], {"a": 1}, [{"a": 1}], ["a"], 2**62, True):
        path.write_bytes(whole)
        change(path, name, pa.array([value] * STEPS))
        with pytest.raises(InvalidInput, match="Trajectory 1"):
            _ = Dataset(root)[1]
    assert [each.where for each in verify(root)] == ["trajectory 1"]


def test_names_that_are_null_are_none(root: Path) -> None:
    write_episodes(root, skills=[["a", None], [None], None], tasks=[[None], ["b", None], []])
    assert Dataset(root).skills == (("a",), (), ())
    assert Dataset(root).tasks == ((), ("b",), ())


@pytest.mark.parametrize("name", [DATA.format(1), "labels/chunk-000/file-000.parquet"])
def test_a_file_of_too_many_rows_is_refused_before_it_is_read(root: Path, name: str) -> None:
    (root / name).parent.mkdir(parents=True, exist_ok=True)
    rows = {each: pa.nulls(10_000_001, pa.int8()) for each in ("episode_index", "action", "label")}
    pq.write_table(pa.table(rows), root / name, row_group_size=10_000_001)
    with pytest.raises(InvalidInput, match="must be a whole file"):
        _ = Dataset(root)[1] if name == DATA.format(1) else labels.labels(root, 0)
