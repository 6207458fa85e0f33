"""Predicted labels lie beside a dataset, count once they are whole, and have nothing to do with what is true."""

from pathlib import Path

import numpy as np
import pytest

from freerein.data import DatasetSpec, create, labels, reached, truth
from freerein.data.labels import LabelsInfo, LabelsWriter
from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ActionSpec, ModelRef, Trajectory

INFO = LabelsInfo(("pick", "push"), ModelRef("segments", "0123456789ab"))
LENGTHS = np.array([4, 4])


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A dataset of two labelled trajectories."""
    action = ActionSpec(size=2, choices=0, names=("x", "y"))
    spec = DatasetSpec(fps=10, cameras={"front": (6, 8, 3)}, action=action, robot_type="arm", skills=("pick", "push"))
    each = Trajectory({"front": np.zeros((4, 6, 8, 3), np.uint8)}, np.zeros((4, 2), np.float32), ("pick", "push"))
    with create(tmp_path / "demos", spec) as writer:
        writer.append(each)
        writer.append(each)
    with LabelsWriter(tmp_path / "demos", name="first") as labeller:
        for index, values in enumerate(([0, 0, 1, 1], [1, 1, 1, -1])):
            labeller.save(index, np.array(values))
        labeller.finish(INFO)
    return tmp_path / "demos"


def test_labels_come_back_with_the_model_that_made_them(root: Path) -> None:
    assert labels.info(root) == INFO
    assert [each.tolist() for each in labels.all_labels(root, LENGTHS)] == [[0, 0, 1, 1], [1, 1, 1, -1]]
    assert labels.labels(root, 1).dtype == np.int64


def test_labels_that_are_not_whole_do_not_count(root: Path) -> None:
    with LabelsWriter(root, name="run") as writer:
        writer.save(0, np.array([0, 0, 1, 1]))
    with pytest.raises(FailedPrecondition, match="skill for every timestep") as refused:
        labels.all_labels(root, LENGTHS)
    assert "freerein segment NAME --save" in refused.value.hint


def test_a_writer_goes_on_only_where_no_other_has_begun_since(root: Path) -> None:
    goes_on = []
    for name in ("run", "run", "another", "run"):
        with LabelsWriter(root, name=name) as writer:
            goes_on.append(writer.goes_on)
    assert goes_on == [False, True, False, False]


def test_one_writer_labels_at_a_time(root: Path) -> None:
    with LabelsWriter(root, name="run") as writer:
        with pytest.raises(FailedPrecondition, match="one writer at a time"):
            LabelsWriter(root, name="another")
        writer.finish(INFO)
    assert labels.info(root) == INFO


def test_a_dataset_that_has_grown_since_must_be_labelled_again(root: Path) -> None:
    for lengths in (np.array([4, 4, 4]), np.array([4, 5])):
        with pytest.raises(FailedPrecondition):
            labels.all_labels(root, lengths)


def test_labels_that_are_no_skills_are_refused(root: Path) -> None:
    with LabelsWriter(root, name="run") as writer:
        writer.save(1, np.array([0, 1, 2, 0]))
        writer.finish(INFO)
    with pytest.raises(InvalidInput, match=r"\[0, 2\)"):
        labels.all_labels(root, LENGTHS)


@pytest.mark.parametrize("text", ["", "[]", '{"skills": ["pick"]}'])
def test_a_corrupt_description_is_refused(root: Path, text: str) -> None:
    (root / "labels" / "info.json").write_text(text)
    with pytest.raises(InvalidInput):
        labels.info(root)


def test_corrupt_labels_are_refused(root: Path) -> None:
    (root / "labels" / "chunk-000" / "file-001.parquet").write_bytes(b"garbage")
    with pytest.raises(InvalidInput):
        labels.labels(root, 1)


def test_predicted_labels_are_no_truth(root: Path) -> None:
    with pytest.raises(NotFound):
        truth.labels(root, 0)


def test_the_fingerprint_tells_labels_apart() -> None:
    some = [np.array([0, 1]), np.array([1])]
    assert labels.fingerprint(some) == labels.fingerprint([each.copy() for each in some])
    assert labels.fingerprint(some) != labels.fingerprint([np.array([0]), np.array([1, 1])])


def test_what_a_reward_model_judges_comes_back_whole_or_not_at_all(root: Path) -> None:
    assert reached.read(root, LENGTHS) == ()
    flags = [np.array([False, False, True, True]), np.array([True, False, False, False])]
    reached.save(root, 0, flags[0])
    with pytest.raises(InvalidInput, match="labels of trajectory 1"):
        reached.read(root, LENGTHS)
    reached.save(root, 1, flags[1])
    assert [each.tolist() for each in reached.read(root, LENGTHS)] == [each.tolist() for each in flags]
    with pytest.raises(InvalidInput, match="each of the 5 frames of trajectory 1"):
        reached.read(root, np.array([4, 5]))
