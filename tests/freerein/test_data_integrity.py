"""Damage is found, named, and comes with a way to mend it."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from freerein.data import Dataset, DatasetSpec, check, create, truth, verify
from freerein.errors import InvalidInput, NotFound
from freerein.types.common import ActionSpec, Trajectory

SPEC = DatasetSpec(
    fps=10,
    cameras={"front": (6, 8, 3)},
    action=ActionSpec(size=2, choices=0, names=("x", "y")),
    robot_type="arm",
    skills=("pick", "push"),
)
SECOND = "data/chunk-000/file-001.parquet"


def trajectory(index: int, *, skills: tuple[str, ...]) -> Trajectory:
    frames = {"front": np.random.default_rng(index).integers(0, 256, (4, 6, 8, 3), dtype=np.uint8)}
    return Trajectory(frames=frames, actions=np.zeros((4, 2), np.float32), skills=skills)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "demos"
    with create(root, SPEC) as writer:
        for index, skills in enumerate([("pick",), ("push",), ("pick", "push")]):
            writer.append(trajectory(index, skills=skills), np.full(4, index % 2))
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "demos"))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def cut_footer(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-8])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def flip_a_bit(path: Path) -> None:
    """Flips one in the last byte of the frames' page: where pages end depends on the digits of the statistics."""
    page = pq.read_metadata(path).row_group(0).column(0)
    data = bytearray(path.read_bytes())
    data[page.data_page_offset + page.total_compressed_size - 1] ^= 1
    path.write_bytes(data)


def take_another(path: Path) -> None:
    path.write_bytes(path.with_name("file-002.parquet").read_bytes())


def test_a_whole_dataset_has_no_problems(root: Path) -> None:
    assert verify(root) == []
    assert [each for each in check(root) if each.severity == "error"] == []


@pytest.mark.parametrize("damage", [truncate, cut_footer, empty, flip_a_bit, take_another, Path.unlink])
def test_a_damaged_data_file_is_found_and_not_read(root: Path, damage: Callable[[Path], None]) -> None:
    damage(root / SECOND)

    problems = verify(root)

    assert [each.where for each in problems if each.where.startswith("data/")] == [SECOND]
    assert all(each.sentence and each.hint for each in problems)
    with pytest.raises(InvalidInput) as caught:
        _ = Dataset(root)[1]
    assert "1" in caught.value.detail
    assert str(root) not in caught.value.detail


def test_two_damaged_files_are_both_found(root: Path) -> None:
    truncate(root / SECOND)
    flip_a_bit(root / "data/chunk-000/file-002.parquet")
    assert [each.where for each in verify(root)][:2] == [SECOND, "data/chunk-000/file-002.parquet"]


def test_wrong_counts_are_found_and_mended_by_opening(root: Path) -> None:
    info = root / "meta/info.json"
    info.write_text(info.read_text().replace('"total_frames": 12', '"total_frames": 13'))
    assert [each.where for each in verify(root)] == ["meta/info.json"]

    Dataset(root)

    assert verify(root) == []


def test_labels_that_do_not_fit_are_found(root: Path) -> None:
    for labels, index in ((np.zeros(3, np.int64), 0), (np.full(4, 2), 1), (np.zeros(4, np.int64), 3)):
        truth.save(root, index, labels)
    assert [each.where for each in verify(root)] == [f"truth/chunk-000/file-00{index}.parquet" for index in (0, 1, 3)]


def test_there_must_be_a_dataset_to_verify(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        verify(tmp_path)


def test_an_empty_dataset_cannot_be_learned_from(tmp_path: Path) -> None:
    create(tmp_path / "demos", SPEC).close()
    (problem,) = check(tmp_path / "demos")
    assert (problem.severity, "empty" in problem.sentence) == ("error", True)
