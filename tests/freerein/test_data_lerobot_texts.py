"""Tasks and subtasks of LeRobot's datasets become tags and true labels."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import DATA, INFO, STEPS, write_dataset, write_episodes, write_info
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, LeRobotSource, TextKind, import_trajectories, truth, verify
from freerein.errors import InvalidInput

TEXTS = ["reach", "pour", "stir"]
NUMBER = {"dtype": "int64", "shape": [1], "names": None}
EACH = [[0, 0, 1, 1, 1], [0, 0, 0, 0, 0], [2, 2, 1, 0, 0]]
"""The text of each timestep, by episode."""

OCCURRING = (("pour", "reach"), ("reach",), ("pour", "reach", "stir"))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "theirs")


def write_texts(root: Path, noun: str, *, in_index: bool = False) -> None:
    """Writes a table of texts, and the column of their indices."""
    texts = pa.table({f"{noun}_index": [2, 1, 0], "__index_level_0__" if in_index else noun: TEXTS[::-1]})
    pq.write_table(texts, root / f"meta/{noun}s.parquet")
    add_column(root, f"{noun}_index", pa.array(np.ravel(EACH)))


def add_column(root: Path, name: str, values: Any) -> None:
    path = root / DATA.format(0)
    pq.write_table(pq.read_table(path).append_column(name, [values]), path)
    write_info(root, features=INFO["features"] | {name: NUMBER})


def write_language(root: Path, *, broadcast: bool = True) -> None:
    """Writes v3.1's rows of language: those of an episode at each of its timesteps, or at their own alone."""
    rows = []
    for numbers in EACH:
        begins = [t for t in range(STEPS) if t == 0 or numbers[t] != numbers[t - 1]]
        subtasks = [language("subtask", TEXTS[numbers[t]], t / 10 + 1e-7) for t in begins]
        others = [language("plan", "first reach", 0.0), language("memory", "poured", 0.3)]
        all_rows = [*others, *subtasks[::-1]]
        for step in range(STEPS):
            rows.append([each for each in all_rows if broadcast or round(10 * each["timestamp"]) == step])
    add_column(root, "language_persistent", pa.array(rows))


def language(style: str, content: str, timestamp: float) -> dict[str, Any]:
    return {"role": "assistant", "content": content, "style": style, "timestamp": timestamp, "tool_calls": None}


def imported(root: Path, **kinds: TextKind) -> Path:
    ours = root.parent / "ours"
    import_trajectories(LeRobotSource(root, **kinds), ours)  # type: ignore[arg-type]
    return ours


def names(ours: Path, index: int) -> list[str]:
    return [Dataset(ours).spec.skills[each] for each in truth.labels(ours, index)]


def check_all(ours: Path) -> None:
    assert Dataset(ours).skills == OCCURRING
    assert [names(ours, index) for index in range(3)] == [[TEXTS[each] for each in numbers] for numbers in EACH]
    assert verify(ours) == []


@pytest.mark.parametrize(("kind", "in_index"), [("task", False), ("subtask", True)])
def test_the_task_or_subtask_of_each_row_gives_tags_and_labels(root: Path, kind: TextKind, in_index: bool) -> None:
    write_texts(root, kind, in_index=in_index)
    check_all(imported(root, tags_from=kind, labels_from=kind))


@pytest.mark.parametrize("broadcast", [True, False])
def test_rows_of_language_in_the_style_of_a_subtask_give_tags_and_labels(root: Path, broadcast: bool) -> None:
    write_language(root, broadcast=broadcast)
    check_all(imported(root, tags_from="subtask", labels_from="subtask"))


def test_the_tasks_of_an_episode_are_its_tags(root: Path) -> None:
    write_episodes(root, tasks=[["pour it", "reach"], ["reach"], []])
    source = LeRobotSource(root)
    assert "1 episodes have several tasks: --tags-from task takes them as tags." in source.notes
    add_column(root, "task_index", pa.array(np.zeros(3 * STEPS, np.int64)))
    assert Dataset(imported(root, tags_from="task")).skills == (("pour it", "reach"), ("reach",), ("tidy",))


def test_a_label_that_the_tags_lack_is_refused(root: Path) -> None:
    write_episodes(root, skills=[["pour", "reach"], ["stir"], ["pour", "reach", "stir"]])
    write_texts(root, "subtask")
    with pytest.raises(InvalidInput, match="labels of trajectory 1 must be among its tags; 1 are not, such as `reach`"):
        imported(root, labels_from="subtask")
    assert not (root.parent / "ours").exists()


def test_timesteps_without_a_text_have_no_label(root: Path) -> None:
    write_texts(root, "subtask")
    pq.write_table(pa.table({"subtask_index": [0, 1], "subtask": ["reach", ""]}), root / "meta/subtasks.parquet")
    ours = imported(root, tags_from="subtask", labels_from="subtask")
    assert Dataset(ours).skills == (("reach",), ("reach",), ("reach",))
    assert truth.labels(ours, 0).tolist() == [0, 0, -1, -1, -1]
    assert verify(ours) == []


def test_subtasks_are_offered_where_there_are_some(root: Path) -> None:
    write_texts(root, "subtask")
    assert "`subtask_index` is left out: take it as tags with --tags-from subtask." in LeRobotSource(root).notes


def test_a_dataset_without_subtasks_is_refused(root: Path) -> None:
    for kind in ("tags_from", "labels_from"):
        with pytest.raises(InvalidInput, match="must have subtasks in a column `subtask_index` or `language_persist"):
            imported(root, **{kind: "subtask"})


@pytest.mark.parametrize(
    "rows",
    [
        [1] * 15,
        [["reach"]] * 15,
        [[{"style": "subtask"}]] * 15,
        [[{"style": "subtask", "content": "reach", "timestamp": float("nan")}]] * 15,
    ],
)
def test_rows_of_language_of_another_kind_are_refused(root: Path, rows: list[Any]) -> None:
    add_column(root, "language_persistent", pa.array(rows))
    with pytest.raises(InvalidInput, match="`language_persistent` must be"):
        imported(root, tags_from="subtask")


def test_the_command_takes_tags_and_labels_and_tags_by_episode(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    write_texts(root, "subtask")
    (tmp_path / "tags.csv").write_text("trajectory,skills\n1,Reach;stir\n")
    words = ["--tags-from", "subtask", "--labels-from", "subtask", "--tags", str(tmp_path / "tags.csv")]
    result = CliRunner().invoke(app, ["dataset", "import", str(root), "ours", *words])
    assert (result.exit_code, "`Reach` was taken for `reach`" in result.stdout) == (0, True)
    ours = tmp_path / "var/datasets/ours"
    assert Dataset(ours).skills == (OCCURRING[0], ("reach", "stir"), OCCURRING[2])
    assert names(ours, 2) == ["stir", "stir", "pour", "reach", "reach"]
    assert json.loads(CliRunner().invoke(app, ["dataset", "inspect", "ours", "--json"]).stdout)["labelled"] == 3
