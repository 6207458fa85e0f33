"""Tags and true labels that people bring as CSV: all of a file or nothing; errors name line and column."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from freerein.data import Dataset, DatasetSpec, create, label, open_writer, tag, truth, verify
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ActionSpec, Trajectory

LENGTH = 4


def trajectory(skills: tuple[str, ...] = ()) -> Trajectory:
    return Trajectory({"top": np.zeros((LENGTH, 6, 8, 3), np.uint8)}, np.zeros((LENGTH, 2), np.float32), skills)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three trajectories without tags."""
    root = tmp_path_factory.mktemp("made") / "demos"
    spec = DatasetSpec(10, {"top": (6, 8, 3)}, ActionSpec(2, 0, ("x", "y")), "arm")
    with create(root, spec) as writer:
        for _ in range(3):
            writer.append(trajectory())
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "demos"))


def test_tags_are_those_of_the_file_and_the_others_stay(root: Path) -> None:
    before = Dataset(root)
    before.cached_actions()
    cached = set((root / "cache").rglob("*"))

    assert tag(root, b"trajectory,skills\r\n0,reach; pour\r\n2,reach\r\n") == 2

    after = Dataset(root)
    assert after.skills == (("pour", "reach"), (), ("reach",))
    assert after.spec.skills == ("pour", "reach")
    assert after.fingerprint != before.fingerprint
    after.cached_actions()
    assert set((root / "cache").rglob("*")) == cached  # no frame is decoded again
    assert verify(root) == []


def test_tags_outlive_the_index_that_is_rebuilt_and_trajectories_that_follow(root: Path) -> None:
    tag(root, b"trajectory,skills\n0,stir\n")
    for path in (root / "meta").rglob("*.*"):
        path.unlink()
    assert Dataset(root).skills[0] == ("stir",)
    with open_writer(root) as writer:
        writer.append(trajectory(("stir",)))
    assert Dataset(root).skills == (("stir",), (), (), ("stir",))
    assert verify(root) == []


def test_a_mistaken_name_is_gone_when_it_is_corrected(root: Path) -> None:
    tag(root, b"trajectory,skills\n0,puor\n1,reach\n")
    tag(root, b"trajectory,skills\n0,pour\n1,\n")
    assert (Dataset(root).skills, Dataset(root).spec.skills) == ((("pour",), (), ()), ("pour",))


def test_labels_keep_their_meaning_when_more_is_tagged(root: Path) -> None:
    tag(root, b"trajectory,skills\n0,reach;stir\n")
    assert label(root, b"trajectory,start,end,skill\n0,0,3,stir\n0,3,4,reach\n") == 1
    tag(root, b"trajectory,skills\n0,pour\n1,wipe\n")
    assert [Dataset(root).spec.skills[each] for each in truth.labels(root, 0)] == ["stir"] * 3 + ["reach"]


def test_a_table_of_tags_is_valid_as_a_whole_or_changes_nothing(root: Path) -> None:
    tag(root, b"trajectory,skills\n1,before\n")
    for text, where in (
        ("", "Line 1 must be"),
        ("trajectory;skills\n", "Line 1 must be"),
        ("trajectory,skills\n0,a\n3,a\n", "Line 3, column `trajectory`"),
        ("trajectory,skills\n0,a\n-1,a\n", "Line 3, column `trajectory`"),
        ("trajectory,skills\n0,a\n\n0,b\n", "Line 4, column `trajectory`"),
        ("trajectory,skills\n0,a;;b\n", "Line 2, column `skills`"),
        (f"trajectory,skills\n0,{'a' * 65}\n", "Line 2, column `skills`"),
        ("trajectory,skills\n0,a\n1,a,b\n", "Line 3 must have 2 columns; it has 3"),
        ('trajectory,skills\n0,"a\n', "must be CSV"),
        ("trajectory,skills\n0,\udcff\n", "must be CSV"),
    ):
        with pytest.raises(InvalidInput, match=where):
            tag(root, text.encode(errors="surrogateescape"))
    assert Dataset(root).skills == ((), ("before",), ())


def test_a_table_of_labels_is_valid_as_a_whole_or_changes_nothing(root: Path) -> None:
    tag(root, b"trajectory,skills\n0,reach;pour\n")
    for lines, where in (
        ("0,0,4,stir", "Line 2, column `skill`"),
        ("0,0,5,reach", "Line 2, column `end`"),
        ("0,2,2,reach", "Line 2, column `end`"),
        ("0,0,2,reach\n0,1,4,pour", "Line 3, column `start`"),
        ("1,0,4,pour\n0,0,2,reach\n0,3,5,pour", "Line 4, column `end`"),
        ("0,x,4,reach", "Line 2, column `start`"),
    ):
        with pytest.raises(InvalidInput, match=where):
            label(root, f"trajectory,start,end,skill\n{lines}\n".encode())
    assert truth.labelled(root) == []


def test_nothing_is_annotated_while_it_is_recorded_or_where_there_is_nothing(root: Path, tmp_path: Path) -> None:
    with open_writer(root), pytest.raises(FailedPrecondition):
        tag(root, b"trajectory,skills\n0,a\n")
    with pytest.raises(NotFound):
        tag(tmp_path / "nothing", b"trajectory,skills\n0,a\n")
    assert not (tmp_path / "nothing").exists()


def test_corrupt_tags_are_an_error_with_a_way_out(root: Path) -> None:
    (root / "tags.json").write_text("[]")
    with pytest.raises(InvalidInput, match=r"tags\.json"):
        Dataset(root)
