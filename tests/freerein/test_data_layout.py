"""The layout on disk, word for word: LeRobotDataset v3.0 as its reader wants it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from freerein.data import Dataset, DatasetSpec, create, open_writer, verify
from freerein.data.layout import dumps
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Trajectory

COUNTER = {"dtype": "int64", "shape": [1], "names": None}
INFO = {
    "codebase_version": "v3.0",
    "robot_type": "arm",
    "total_episodes": 2,
    "total_frames": 7,
    "total_tasks": 1,
    "chunks_size": 1000,
    "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200,
    "fps": 20,
    "splits": {"train": "0:2"},
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": None,
    "features": {
        "observation.images.front": {
            "dtype": "image",
            "shape": [6, 8, 3],
            "names": ["height", "width", "channels"],
        },
        "action": {"dtype": "float32", "shape": [2], "names": ["x", "y"]},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        "frame_index": COUNTER,
        "episode_index": COUNTER,
        "index": COUNTER,
        "task_index": COUNTER,
    },
}
DATA_COLUMNS = {
    "observation.images.front": pa.struct([("bytes", pa.binary()), ("path", pa.string())]),
    "action": pa.list_(pa.float32(), 2),
    "timestamp": pa.float32(),
    "frame_index": pa.int64(),
    "episode_index": pa.int64(),
    "index": pa.int64(),
    "task_index": pa.int64(),
}
EPISODES = {
    "episode_index": [0, 1],
    "tasks": [["tidy the desk"], ["tidy the desk"]],
    "length": [3, 4],
    "data/chunk_index": [0, 0],
    "data/file_index": [0, 1],
    "dataset_from_index": [0, 3],
    "dataset_to_index": [3, 7],
    "meta/episodes/chunk_index": [0, 0],
    "meta/episodes/file_index": [0, 0],
    "skills": [["pick", "push"], []],
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    spec = DatasetSpec(
        fps=20,
        cameras={"front": (6, 8, 3)},
        action=ActionSpec(size=2, choices=0, names=("x", "y")),
        robot_type="arm",
        skills=("pick", "push"),
        task="tidy the desk",
    )
    with create(tmp_path / "demos", spec) as writer:
        for length, skills in ((3, ("pick", "push")), (4, ())):
            frames = {"front": np.full((length, 6, 8, 3), 51 * length, np.uint8)}
            actions = np.linspace(-1, 1, 2 * length, dtype=np.float32).reshape(length, 2)
            writer.append(Trajectory(frames=frames, actions=actions, skills=skills))
    return tmp_path / "demos"


def test_the_files_are_those_of_lerobot_and_one_of_ours(root: Path) -> None:
    assert sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()) == [
        "data/chunk-000/file-000.parquet",
        "data/chunk-000/file-001.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/freerein.json",
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
        "writer.lock",
    ]


def test_info_is_what_lerobot_writes(root: Path) -> None:
    assert json.loads((root / "meta/info.json").read_text()) == INFO


def test_a_data_file_has_the_columns_that_info_names(root: Path) -> None:
    table = pq.read_table(root / "data/chunk-000/file-001.parquet")
    assert {field.name: field.type for field in table.schema} == DATA_COLUMNS
    np.testing.assert_allclose(table["timestamp"], [0.0, 0.05, 0.1, 0.15])
    assert table["frame_index"].to_pylist() == [0, 1, 2, 3]
    assert table["episode_index"].to_pylist() == [1, 1, 1, 1]
    assert table["index"].to_pylist() == [3, 4, 5, 6]
    assert table["task_index"].to_pylist() == [0, 0, 0, 0]
    assert table["observation.images.front"][0]["bytes"].as_py().startswith(b"\x89PNG")


def test_episodes_have_lerobots_columns_and_the_skills(root: Path) -> None:
    table = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet")
    assert table.select(list(EPISODES)).to_pydict() == EPISODES
    assert {name.split("/")[1] for name in table.column_names if name.startswith("stats/")} == set(DATA_COLUMNS)
    assert table["stats/observation.images.front/count"].to_pylist() == [[3], [4]]


def test_tasks_are_indexed_by_their_text_as_pandas_wants_it(root: Path) -> None:
    table = pq.read_table(root / "meta/tasks.parquet")
    assert table.to_pydict() == {"task_index": [0], "task": ["tidy the desk"]}
    assert table.schema.pandas_metadata["index_columns"] == ["task"]


def test_every_goal_text_is_a_task_numbered_by_its_first_appearance(root: Path) -> None:
    with open_writer(root) as writer:
        for text in ("lift it", "tidy the desk", "lift it"):
            frames = {"front": np.zeros((2, 6, 8, 3), np.uint8)}
            writer.append(Trajectory(frames=frames, actions=np.zeros((2, 2), np.float32), goal_text=text))
    tasks = pq.read_table(root / "meta/tasks.parquet").to_pydict()
    assert tasks == {"task_index": [0, 1], "task": ["tidy the desk", "lift it"]}
    assert json.loads((root / "meta/info.json").read_text())["total_tasks"] == 2
    columns = [pq.read_table(path)["task_index"][0].as_py() for path in sorted((root / "data").rglob("*.parquet"))]
    assert columns == [0, 0, 1, 0, 1]
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet")
    assert [text for (text,) in episodes["tasks"].to_pylist()][2:] == ["lift it", "tidy the desk", "lift it"]


def test_a_data_file_from_before_there_were_goal_texts_is_read(root: Path) -> None:
    path = root / "data/chunk-000/file-001.parquet"
    table = pq.read_table(path)
    footer = json.loads(table.schema.metadata[b"freerein"])
    assert footer.pop("goal_text") == ""
    pq.write_table(table.replace_schema_metadata({b"freerein": json.dumps(footer).encode()}), path)
    assert Dataset(root).goal_texts == ("tidy the desk", "tidy the desk")


def test_a_spec_from_before_there_were_terminations_is_read(root: Path) -> None:
    path = root / "meta/freerein.json"
    spec = json.loads(path.read_text())
    assert spec.pop("has_terminations") is False
    path.write_text(json.dumps(spec))
    assert not Dataset(root).spec.has_terminations


def test_terminations_are_a_bool_feature_with_lerobots_statistics(root: Path) -> None:
    with create(root.parent / "crashes", replace(Dataset(root).spec, has_terminations=True)) as writer:
        for each, ends in zip(Dataset(root), ([False, False, True], [False] * 4), strict=True):
            writer.append(replace(each, terminated=np.array(ends)))
    meta = root.parent / "crashes/meta"
    features = json.loads((meta / "info.json").read_text())["features"]
    assert features.pop("next.terminated") == {"dtype": "bool", "shape": [1], "names": None}
    assert features == INFO["features"]
    columns = pq.read_schema(root.parent / "crashes/data/chunk-000/file-000.parquet")
    assert columns.field("next.terminated").type == pa.bool_()
    stats = json.loads((meta / "stats.json").read_text())["next.terminated"]
    assert {name: stats[name] for name in ("min", "max", "count")} == {"min": [0.0], "max": [1.0], "count": [7.0]}
    np.testing.assert_allclose([*stats["mean"], *stats["std"]], [1 / 7, np.sqrt(6) / 7])


def test_a_state_of_the_robot_is_lerobots_feature(root: Path) -> None:
    states = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
    spec = replace(Dataset(root).spec, robot_state_size=3, robot_state_names=("a", "b", "c"))
    with create(root.parent / "arm", spec) as writer:
        writer.append(Dataset(root)[1], robot_state=states)
        for wrong in (None, states[:3], states.astype(float), states * np.nan):
            with pytest.raises(InvalidInput, match="robot's state"):
                writer.append(Dataset(root)[1], robot_state=wrong)
    features = json.loads((root.parent / "arm/meta/info.json").read_text())["features"]
    assert features.pop("observation.state") == {"dtype": "float32", "shape": [3], "names": ["a", "b", "c"]}
    assert features == INFO["features"]
    columns = pq.read_schema(root.parent / "arm/data/chunk-000/file-000.parquet")
    assert columns.field("observation.state").type == pa.list_(pa.float32(), 3)
    np.testing.assert_array_equal(Dataset(root.parent / "arm").robot_state(0), states)
    assert Dataset(root).robot_state(0) is None
    assert verify(root.parent / "arm") == []
    with open_writer(root) as writer, pytest.raises(InvalidInput, match="none, as the dataset has none"):
        writer.append(Dataset(root)[1], robot_state=states)


def test_quantiles_are_exact_in_a_trajectory_and_weighted_means_of_many(root: Path) -> None:
    with open_writer(root) as writer:
        actions = np.random.default_rng(0).permutation(np.linspace(-1, 1, 70)).repeat(2).reshape(70, 2)
        frames = np.zeros((70, 6, 8, 3), np.uint8)
        frames[:7] = 255  # one in ten: the 90 % quantile is still black
        writer.append(Trajectory(frames={"front": frames}, actions=actions.astype(np.float32)))
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet")
    expected = {"q01": 0, "q10": 6, "q50": 34, "q90": 62, "q99": 69}
    for name, rank in expected.items():
        values = np.array(episodes[f"stats/action/{name}"].to_pylist())
        np.testing.assert_allclose(values[2], np.linspace(-1, 1, 70)[rank], rtol=1e-6)
        assert np.ravel(episodes[f"stats/observation.images.front/{name}"][2].as_py()).tolist() == [name == "q99"] * 3
        stats = json.loads((root / "meta/stats.json").read_text())["action"]
        np.testing.assert_allclose(stats[name], (values * [[3], [4], [70]]).sum(axis=0) / 77)


def test_a_dataset_from_before_there_were_quantiles_is_read_and_continued(root: Path) -> None:
    remove_quantiles(root)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    assert len(Dataset(root)) == 2
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before  # and is left alone
    with open_writer(root) as writer:
        writer.append(Dataset(root)[0])
    assert (len(Dataset(root)), verify(root)) == (3, [])
    (root / "meta/episodes/chunk-000/file-000.parquet").unlink()
    assert len(Dataset(root)) == 3  # from the footers of the data files
    assert set(json.loads((root / "meta/stats.json").read_text())["action"]) == {"min", "max", "mean", "std", "count"}


def remove_quantiles(root: Path) -> None:
    """Makes a dataset what earlier versions wrote."""
    for path in (root / "data").rglob("*.parquet"):
        table = pq.read_table(path)
        footer = json.loads(table.schema.metadata[b"freerein"])
        footer["statistics"] = {
            feature: {name: each[name] for name in each if name[0] != "q"}
            for feature, each in footer["statistics"].items()
        }
        pq.write_table(table.replace_schema_metadata({b"freerein": json.dumps(footer).encode()}), path)
    (root / "meta/episodes/chunk-000/file-000.parquet").unlink()
    _ = Dataset(root)  # rebuilds `meta/`
    path = root / "meta/episodes/chunk-000/file-000.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop([name for name in table.column_names if "/q" in name]), path)


def test_statistics_are_of_all_frames_in_lerobots_shapes(root: Path) -> None:
    stats = json.loads((root / "meta/stats.json").read_text())
    assert set(stats) == set(DATA_COLUMNS)
    pixels = np.repeat([0.6, 0.8], [3, 4])
    for name, expected in {"min": 0.6, "max": 0.8, "mean": pixels.mean(), "std": pixels.std()}.items():
        np.testing.assert_allclose(stats["observation.images.front"][name], np.full((3, 1, 1), expected))
    actions = np.concatenate([np.linspace(-1, 1, 2 * length).reshape(length, 2) for length in (3, 4)])
    np.testing.assert_allclose(stats["action"]["std"], actions.std(axis=0), rtol=1e-6)
    assert stats["action"]["count"] == [7]


def test_a_period_that_is_no_whole_rate_is_kept_beside_lerobots_fps(tmp_path: Path) -> None:
    action = ActionSpec(1, 4, tuple("abcd"), hold=3)
    spec = DatasetSpec(9, {"front": (6, 8, 3)}, action, robot_type="arm", control_dt_s=4 / 35)
    with create(tmp_path / "exact", spec) as writer:
        writer.append(Trajectory({"front": np.zeros((2, 6, 8, 3), np.uint8)}, np.zeros((2, 1), np.int64)))
    shutil.rmtree(tmp_path / "exact/meta")  # the data files say it, too
    found = Dataset(tmp_path / "exact").spec
    assert (found.control_dt_s, found.fps, found.action.hold) == (4 / 35, 9, 3)


def test_a_spec_without_a_period_of_its_own_keeps_its_bytes(root: Path) -> None:
    spec = Dataset(root).spec
    assert spec.control_dt_s == 1 / spec.fps
    assert "control_dt_s" not in dumps(spec)
    assert "hold" not in dumps(spec)


@pytest.mark.parametrize("period", [0.2, 2.5, -1, float("nan")])
def test_a_period_of_another_rate_is_refused(root: Path, period: float) -> None:
    with pytest.raises(InvalidInput, match="control_dt_s"):
        replace(Dataset(root).spec, control_dt_s=period)
