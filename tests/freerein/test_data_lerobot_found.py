"""LeRobot's rows are found by `episode_index` and `frame_index`, whatever their order and the numbering of episodes."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import DATA, EPISODES, STEPS, rows_of, write_data, write_dataset, write_episodes, write_info

from freerein.data import Dataset, LeRobotSource, import_trajectories, tag, verify
from freerein.errors import InvalidInput


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "theirs")


def found(dataset: Dataset) -> list[tuple[list[float], list[int], list[int]]]:
    """Returns the episodes of the actions, their timesteps, and the brightness of the frames, by trajectory."""
    return [(*each.actions.T.tolist(), each.frames["top"][:, 0, 0, 0].tolist()) for each in dataset]


def expected(*episodes: int) -> list[tuple[list[float], list[int], list[int]]]:
    steps = list(range(STEPS))
    return [([each] * STEPS, [-step for step in steps], [10 * each + step for step in steps]) for each in episodes]


@pytest.mark.parametrize("kept", [[1, 2], [2, 0]])
def test_episodes_are_found_by_their_number_after_others_were_deleted(
    root: Path, tmp_path: Path, kept: list[int]
) -> None:
    pq.write_table(pq.read_table(root / EPISODES).take(kept), root / EPISODES)
    assert Dataset(root).episodes == tuple(sorted(kept))
    assert found(Dataset(root)) == expected(*sorted(kept))
    assert verify(root) == []
    import_trajectories(LeRobotSource(root), tmp_path / "ours")
    assert found(Dataset(tmp_path / "ours")) == expected(*sorted(kept))


def test_what_was_cached_before_an_episode_was_deleted_is_not_used_after(root: Path) -> None:
    Dataset(root).cached_actions()
    pq.write_table(pq.read_table(root / EPISODES).take([0, 2]), root / EPISODES)
    assert Dataset(root).cached_actions()[1].tolist() == [[2, -step] for step in range(STEPS)]


def test_tags_name_an_episode_by_its_number(root: Path) -> None:
    pq.write_table(pq.read_table(root / EPISODES).take([1, 2]), root / EPISODES)
    tag(root, b"trajectory,skills\n1,reach\n")
    assert Dataset(root).skills == (("reach",), ())
    with pytest.raises(InvalidInput, match="Line 2, column `trajectory`"):
        tag(root, b"trajectory,skills\n0,reach\n")


@pytest.mark.parametrize(("counted", "found"), [(3, "3"), (10**400, "[0-9]+"), (None, "no number"), ([3], "no number")])
def test_a_count_of_other_episodes_than_are_listed_is_said(root: Path, counted: Any, found: str) -> None:
    write_info(root, total_episodes=counted)
    pq.write_table(pq.read_table(root / EPISODES).take([0, 2]), root / EPISODES)
    (note, renumbered) = LeRobotSource(root).notes
    assert re.search(f"`info.json` counts {found}, `meta/episodes` lists 2", note)
    assert "episode 2 is now trajectory 1" in renumbered


def test_an_episode_that_is_listed_twice_is_refused_by_its_number(root: Path) -> None:
    write_episodes(root, episode_index=[0, 1, 1])
    with pytest.raises(InvalidInput, match="episode 1 again"):
        Dataset(root)


def replace_rows(root: Path, frame_index: list[int | None]) -> None:
    """Gives the rows of episode 1 other numbers, and puts them into that order."""
    table = pa.table(rows_of(1))
    column = table.column_names.index("frame_index")
    shuffled = table.take([each or 0 for each in frame_index])
    shuffled = shuffled.set_column(column, "frame_index", pa.array(frame_index, pa.int64()))
    rows = [pa.table(rows_of(0)), shuffled, pa.table(rows_of(2))]
    pq.write_table(pa.concat_tables(rows), root / DATA.format(0))


def test_rows_are_in_the_order_of_their_numbers(root: Path) -> None:
    replace_rows(root, [2, 4, 0, 3, 1])
    dataset = Dataset(root)
    assert found(dataset) == expected(0, 1, 2)
    assert dataset.cached_actions()[1][:, 1].tolist() == [-step for step in range(STEPS)]
    assert next(dataset.first_frames([1], "top"))[0, 0, 0] == 10


def test_rows_of_an_episode_may_lie_between_those_of_another(root: Path) -> None:
    table = pq.read_table(root / DATA.format(0))
    pq.write_table(table.take(np.random.default_rng(0).permutation(len(table))), root / DATA.format(0))
    assert found(Dataset(root)) == expected(0, 1, 2)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ([0, 1, 1, 2, 3], "1 is there twice"),
        ([0, 1, 2, 4, 5], "3 is missing"),
        ([1, 2, 3, 4, 5], "0 is missing"),
        ([0, 0, 0, 0, 0], "0 is there twice"),
        ([0, 1, None, 3, 4], "2 is missing"),
    ],
)
def test_numbers_of_rows_that_are_missing_or_there_twice_are_named(
    root: Path, numbers: list[int | None], words: str
) -> None:
    table = pa.table(rows_of(1))
    column = table.column_names.index("frame_index")
    changed = table.set_column(column, "frame_index", pa.array(numbers, pa.int64()))
    pq.write_table(pa.concat_tables([pa.table(rows_of(0)), changed, pa.table(rows_of(2))]), root / DATA.format(0))
    with pytest.raises(InvalidInput) as caught:
        _ = Dataset(root)[1]
    assert caught.value.detail.startswith("Trajectory 1, `data/chunk-000/file-000.parquet`: ")
    assert words in caught.value.detail
    assert [each.where for each in verify(root)] == ["trajectory 1"]


@pytest.mark.parametrize(
    ("files", "named"),
    [
        ([[0], [1], [2]], [0, 0, 2]),
        ([[0], [1], [2]], [7, 8, 9]),
        ([[0, 1, 2]], [0, 1, 2]),
        ([[0], [2], [1]], [0, 1, 2]),
    ],
)
def test_an_episode_is_found_where_the_table_names_another_file(
    root: Path, tmp_path: Path, files: list[list[int]], named: list[int]
) -> None:
    write_data(root, *files)
    write_episodes(root, **{"data/file_index": named})
    assert found(Dataset(root)) == expected(0, 1, 2)
    assert Dataset(root).cached_actions()[1][:, 0].tolist() == [1] * STEPS
    import_trajectories(LeRobotSource(root), tmp_path / "ours")
    assert found(Dataset(tmp_path / "ours")) == expected(0, 1, 2)


def test_rows_of_an_episode_may_lie_in_two_files(root: Path) -> None:
    table = pq.read_table(root / DATA.format(0))
    pq.write_table(table.slice(0, 7), root / DATA.format(0))
    pq.write_table(table.slice(7), root / DATA.format(1))
    assert found(Dataset(root)) == expected(0, 1, 2)


def test_an_episode_without_rows_anywhere_is_named(root: Path) -> None:
    write_data(root, [0, 2])
    with pytest.raises(InvalidInput, match="timesteps that `meta/` names; the data has 0"):
        _ = Dataset(root)[1]


def test_columns_of_episodes_that_are_not_needed_are_not_read(root: Path) -> None:
    statistics = np.random.default_rng(0).normal(size=3)
    pq.write_table(pq.read_table(root / EPISODES).append_column("stats/action/mean", [statistics]), root / EPISODES)
    page = pq.read_metadata(root / EPISODES).row_group(0).column(4)
    data = bytearray((root / EPISODES).read_bytes())
    begin = page.dictionary_page_offset or page.data_page_offset
    data[begin : begin + page.total_compressed_size] = b"\xff" * page.total_compressed_size
    (root / EPISODES).write_bytes(data)
    with pytest.raises(OSError, match="thrift"):
        pq.read_table(root / EPISODES)
    assert found(Dataset(root)) == expected(0, 1, 2)


def test_a_damaged_file_is_named_although_others_were_searched(root: Path) -> None:
    write_data(root, [0], [1], [2])
    write_episodes(root, **{"data/file_index": [0, 1, 2]})
    table = pq.read_table(root / DATA.format(2))
    pq.write_table(table, root / DATA.format(2), write_statistics=False)  # may hold any episode
    (root / DATA.format(1)).write_bytes(b"PAR1")
    with pytest.raises(InvalidInput, match=r"file-001\.parquet`: The data file must be a whole file"):
        _ = Dataset(root)[1]
