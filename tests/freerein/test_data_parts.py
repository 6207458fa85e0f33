"""A few frames of a trajectory are those frames, in whatever file they lie, and cost no more when it is long."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.lerobot_dataset import DATA, STEPS, rows_of, write_dataset

from freerein.data import Dataset, DatasetSpec, create
from freerein.data.trajectory_part import read_part
from freerein.errors import InvalidInput
from freerein.types.common import ActionSpec, Trajectory

LENGTH = 600  # more than two row groups


def numbered(length: int) -> npt.NDArray[np.uint8]:
    """Returns frames whose first pixel tells the timestep."""
    frames = np.zeros((length, 4, 6, 3), np.uint8)
    frames[:, 0, 0, 0], frames[:, 0, 0, 1] = np.divmod(np.arange(length), 256)
    return frames


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a dataset of a short trajectory and a long one."""
    root = tmp_path_factory.mktemp("datasets") / "long"
    spec = DatasetSpec(fps=10, cameras={"front": (4, 6, 3)}, action=ActionSpec(1, 2, ("a", "b")), robot_type="arm")
    with create(root, spec) as writer:
        for length in (3, LENGTH):
            writer.append(Trajectory({"front": numbered(length)}, np.zeros((length, 1), np.int64)))
    return root


@pytest.mark.parametrize("part", [slice(0, 1), slice(250, 260), slice(255, 514), slice(590, 700), slice(None)])
def test_frames_of_a_part_are_those_of_the_whole(root: Path, part: slice) -> None:
    assert np.array_equal(Dataset(root).frames(1, "front", part), numbered(LENGTH)[part])


def test_other_row_groups_are_not_read(root: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(root, tmp_path / "long")
    path = copy / "data/chunk-000/file-001.parquet"
    first = pq.read_metadata(path).row_group(0).column(0)
    with path.open("r+b") as file:
        file.seek(first.data_page_offset)
        file.write(bytes(first.total_compressed_size))
    damaged = Dataset(copy)
    assert np.array_equal(damaged.frames(1, "front", slice(300, 310)), numbered(LENGTH)[300:310])
    with pytest.raises(InvalidInput, match="missing, truncated or corrupt"):
        damaged.frames(1, "front", slice(250, 260))


@pytest.mark.parametrize("order", [range(STEPS), [4, 2, 0, 1, 3]], ids=["in order", "out of order"])
def test_frames_are_found_among_episodes_of_another_tool(tmp_path: Path, order: Any) -> None:
    write_dataset(tmp_path)
    tables = [pa.table(rows_of(each)).take(list(order)) for each in (0, 1, 2)]
    pq.write_table(pa.concat_tables(tables), tmp_path / DATA.format(0), row_group_size=4)
    dataset = Dataset(tmp_path)
    for index in range(3):
        frames = dataset.frames(index, "top", slice(1, 4))
        assert frames[:, 0, 0, 0].tolist() == [10 * index + step for step in (1, 2, 3)]


def test_a_part_that_the_file_does_not_have_is_not_returned(tmp_path: Path) -> None:
    path = tmp_path / "file.parquet"
    pq.write_table(pa.table({"image": [b"a", b"b"], "episode_index": [0, 0], "frame_index": [0, 2]}), path)
    assert read_part(path, "image", index=0, timesteps=range(2)) is None
    assert read_part(path, "image", index=0, timesteps=range(3)) is None
    assert read_part(path, "image", index=1, timesteps=range(1)) is None
