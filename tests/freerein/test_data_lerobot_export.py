"""Labels go back into the LeRobotDataset that a dataset was imported from."""

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import DATA, EPISODES, STEPS, write_data, write_dataset, write_episodes, write_info
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, LeRobotSource, import_trajectories, label, truth
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.data.language_rows import subtasks_of, with_subtasks
from freerein.data.lerobot_export import export_labels
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ModelRef

SKILLS = ("pour", "reach", "stir")
LABELS = [[-1, 1, 1, 0, 0], [1, 1, 1, 1, 1], [1, 2, -1, -1, 0]]
"""Those of each timestep, by trajectory."""


@pytest.fixture
def original(tmp_path: Path) -> Path:
    root = write_dataset(tmp_path / "theirs")
    write_data(root, [0, 1], [2])
    write_episodes(root, **{"data/file_index": [0, 0, 1]})
    return root


@pytest.fixture
def ours(original: Path) -> Path:
    root = original.parent / "var/datasets/ours"
    import_trajectories(LeRobotSource(original, size=(2, 3), tags=b"trajectory,skills\n0,pour;reach;stir\n"), root)
    save_labels(root, LABELS)
    return root


def save_labels(root: Path, labels: list[list[int]]) -> None:
    with LabelsWriter(root, name="test") as writer:
        for index, values in enumerate(labels):
            writer.save(index, np.array(values))
        writer.finish(LabelsInfo(SKILLS, ModelRef("m", "v")))


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def language(root: Path, file: int = 0) -> list[Any]:
    return pq.read_table(root / DATA.format(file))["language_persistent"].to_pylist()


def test_what_is_exported_comes_back_by_our_own_import(original: Path, ours: Path) -> None:
    assert export_labels(ours, original) == 3
    again = original.parent / "again"
    import_trajectories(LeRobotSource(original, tags_from="subtask", labels_from="subtask"), again)
    assert Dataset(again).spec.skills == SKILLS
    assert [truth.labels(again, index).tolist() for index in range(3)] == LABELS


def test_each_timestep_has_the_subtasks_of_its_episode_and_all_else_stays(original: Path, ours: Path) -> None:
    before, tables = contents(original), [pq.read_table(original / DATA.format(file)) for file in range(2)]
    export_labels(ours, original)
    rows = language(original)
    assert [(each["timestamp"], each["content"]) for each in rows[4]] == [
        (pytest.approx(0.1), "reach"),
        (pytest.approx(0.3), "pour"),
    ]
    assert {json.dumps(each) for each in rows[:STEPS]} == {json.dumps(rows[0])}
    assert [each["content"] for each in rows[STEPS]] == ["reach"]
    assert [each["content"] for each in language(original, 1)[0]] == ["reach", "stir", "", "pour"]
    assert {(each["role"], each["style"], each["camera"]) for each in rows[0]} == {("assistant", "subtask", None)}
    for file, table in enumerate(tables):
        assert pq.read_table(original / DATA.format(file)).drop_columns(["language_persistent"]) == table
    changed = {name for name, data in contents(original).items() if before.get(name) != data}
    shares = {f"meta/temporal_proportions_{kind}.json" for kind in ("sparse", "dense")}
    assert changed == {DATA.format(0), DATA.format(1), EPISODES, "meta/info.json"} | shares
    info = json.loads((original / "meta/info.json").read_text())
    assert info["features"].pop("language_persistent") == {"dtype": "language", "shape": [1], "names": None}
    assert info == json.loads(before["meta/info.json"])


def test_sarm_finds_the_stages_of_each_episode(original: Path, ours: Path) -> None:
    export_labels(ours, original)
    (row, _, last) = pq.read_table(original / EPISODES).to_pylist()
    for kind in ("sparse", "dense"):
        assert row[f"{kind}_subtask_names"] == ["reach", "pour"]
        assert (row[f"{kind}_subtask_start_frames"], row[f"{kind}_subtask_end_frames"]) == ([1, 3], [2, 4])
        assert (row[f"{kind}_subtask_start_times"], row[f"{kind}_subtask_end_times"]) == ([0.1, 0.3], [0.3, 0.5])
        assert (last[f"{kind}_subtask_names"], last[f"{kind}_subtask_end_frames"]) == (
            ["reach", "stir", "pour"],
            [0, 1, 4],
        )
        shares = json.loads((original / f"meta/temporal_proportions_{kind}.json").read_text())
        assert list(shares) == ["stir", "reach", "pour"]
        assert sum(shares.values()) == pytest.approx(1)


def test_an_export_is_repeated_without_a_change_and_completes_one_that_was_cut_short(
    original: Path, ours: Path, tmp_path: Path
) -> None:
    half = shutil.copytree(original, tmp_path / "half")
    export_labels(ours, original)
    whole = contents(original)
    export_labels(ours, original)
    assert contents(original) == whole
    shutil.copy(original / DATA.format(0), half / DATA.format(0))  # renamed before the process was killed
    (half / DATA.format(1)).with_suffix(".parquet.tmp").write_bytes(b"PAR1")
    export_labels(ours, half)
    assert contents(half) == whole


def test_a_failure_leaves_all_files_as_they_were(original: Path, ours: Path) -> None:
    before = contents(original)
    (original / f"{EPISODES}.tmp").mkdir()  # where the second file is written
    with pytest.raises(OSError, match="directory"):
        export_labels(ours, original)
    assert contents(original) == before


def test_texts_of_other_styles_stay_and_others_subtasks_are_replaced_only_on_request(
    original: Path, ours: Path
) -> None:
    path = original / DATA.format(0)
    plan = {"role": "user", "content": "first reach", "style": "plan", "timestamp": 0.0, "tool_calls": None}
    theirs = plan | {"style": "subtask", "content": "grasp"}
    rows = [[theirs, plan] if step == 2 else [] for step in range(2 * STEPS)]
    pq.write_table(pq.read_table(path).append_column("language_persistent", pa.array(rows)), path)
    before = contents(original)
    with pytest.raises(AlreadyExists, match="`language_persistent` of episode 0 has some") as refused:
        export_labels(ours, original)
    assert "--replace" in refused.value.hint
    assert contents(original) == before
    export_labels(ours, original, replaces=True)
    assert [each["content"] for each in language(original)[2]] == ["first reach", "reach", "pour"]
    assert [each["content"] for each in language(original)[1]] == ["reach", "pour"]


@pytest.mark.parametrize(
    ("column", "found"),
    [
        (["reach"], "got string"),
        ([["reach"]], "got lists of string"),
        ([[{"content": "reach", "timestamp": 0.0}]], "`style` is missing"),
        ([[{"content": "reach", "style": 1, "timestamp": 0.0}]], "`style` is int64"),
        ([[{"content": "reach", "style": "plan", "timestamp": "0"}]], "`timestamp` is string"),
    ],
)
def test_a_column_of_other_texts_is_refused(column: list[Any], found: str) -> None:
    rows = pa.table({"episode_index": [0], "language_persistent": pa.array(column)})
    for read in (subtasks_of, partial(with_subtasks, subtasks={})):
        with pytest.raises(InvalidInput, match=found):
            read(rows)


def test_features_that_are_no_objects_and_times_that_are_not_finite_are_refused(original: Path, ours: Path) -> None:
    features: object
    for features in (None, ["action"], {"action": []}):
        write_info(original, features=features)
        with pytest.raises(InvalidInput, match="must describe `features`"):
            export_labels(ours, original)
    write_info(original)
    path = original / DATA.format(0)
    table = pq.read_table(path)
    for time_s in (None, float("nan"), float("inf")):
        times = pa.array([0.0, time_s, *[0.2] * (2 * STEPS - 2)], pa.float32())
        pq.write_table(table.append_column("timestamp", times), path)
        with pytest.raises(InvalidInput, match="`timestamp` of episode 0 must be a finite number"):
            export_labels(ours, original)


def test_an_episode_in_two_data_files_has_the_timesteps_of_both_and_files_keep_their_mode(
    original: Path, ours: Path
) -> None:
    rows = pa.concat_tables(pq.read_table(original / DATA.format(file)) for file in range(2))
    pq.write_table(rows.slice(2), original / DATA.format(0))
    pq.write_table(rows.slice(0, 2), original / DATA.format(1))
    (original / DATA.format(0)).chmod(0o664)
    export_labels(ours, original)
    assert (original / DATA.format(0)).stat().st_mode & 0o777 == 0o664
    for file in range(2):
        texts = [(each["timestamp"], each["content"]) for each in language(original, file)[0]]
        assert texts == [(pytest.approx(0.1), "reach"), (pytest.approx(0.3), "pour")]


def test_stages_that_people_made_are_not_replaced_without_a_request(original: Path, ours: Path) -> None:
    write_episodes(original, sparse_subtask_names=[["fold"], None, None], **{"data/file_index": [0, 0, 1]})
    with pytest.raises(AlreadyExists, match="`sparse_subtask_names` has some"):
        export_labels(ours, original)
    export_labels(ours, original, replaces=True)
    save_labels(ours, [[0] * STEPS] * 3)
    with pytest.raises(AlreadyExists):
        export_labels(ours, original)


def test_episodes_are_matched_in_the_order_of_their_numbers(original: Path, ours: Path) -> None:
    write_episodes(original, episode_index=[4, 7, 9], **{"data/file_index": [0, 0, 1]})
    write_data(original, [7, 4], [9])
    export_labels(ours, original)
    assert [each["content"] for each in language(original)[0]] == ["reach"]
    assert [each["content"] for each in language(original)[-1]] == ["reach", "pour"]


@pytest.mark.parametrize(
    ("columns", "fps", "sentence"),
    [
        ({"length": [STEPS, STEPS, 4]}, 10, "must have 5 timesteps in episode 2, as the dataset; it has 4"),
        ({}, 30, "must have 10 timesteps per second, as the dataset; it has 30"),
        ({"episode_index": [0, 1, 3]}, 10, "Episode 3 must have 5 timesteps in the data files; it has 0"),
    ],
)
def test_a_dataset_of_other_episodes_is_refused(
    original: Path, ours: Path, columns: dict[str, list[int]], fps: int, sentence: str
) -> None:
    write_episodes(original, **{"data/file_index": [0, 0, 1]} | columns)
    write_info(original, fps=fps)
    before = contents(original)
    with pytest.raises(InvalidInput, match=sentence):
        export_labels(ours, original)
    assert contents(original) == before


def test_a_dataset_with_fewer_episodes_our_own_and_none_are_refused(original: Path, ours: Path, tmp_path: Path) -> None:
    episodes = pq.read_table(original / EPISODES).slice(0, 2)
    pq.write_table(episodes, original / EPISODES)
    with pytest.raises(InvalidInput, match="must have the 3 episodes of the dataset; it has 2"):
        export_labels(ours, original)
    with pytest.raises(InvalidInput, match="this one is freerein's"):
        export_labels(ours, ours)
    with pytest.raises(NotFound, match="must be a LeRobotDataset v3 in the folder"):
        export_labels(ours, tmp_path / "nowhere")
    (ours / "labels/info.json").unlink()
    with pytest.raises(FailedPrecondition, match="must have a skill for every timestep"):
        export_labels(ours, original)


def test_the_command_writes_all_forms_and_says_where(
    original: Path, ours: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    table, folder = tmp_path / "out/labels.csv", tmp_path / "subtitles"
    words = ["dataset", "export", "ours", "--lerobot", str(original), "--csv", str(table), "--vtt", str(folder)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [f"The labels of ours are in {path}." for path in (original, table, folder)]
    assert table.read_text().splitlines()[:3] == ["trajectory,start,end,skill", "0,1,3,reach", "0,3,5,pour"]
    cues = (folder / "trajectory-002.vtt").read_text().split("\n\n")
    assert cues[-1] == "00:00:00.400 --> 00:00:00.500\npour\n"
    label(ours, table.read_bytes(), with_tags=True)
    assert [truth.labels(ours, index).tolist() for index in range(3)] == LABELS
    result = CliRunner().invoke(app, ["dataset", "export", "ours"])
    assert (result.exit_code, "A form must be chosen" in result.stderr) == (1, True)
