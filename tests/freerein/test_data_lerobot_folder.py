"""A dataset goes out as a LeRobotDataset v3 folder, and comes back equal."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from freerein.cli.__main__ import app
from freerein.data import Dataset, DatasetSpec, create, hand_labels, read_teachers, save_teachers, truth
from freerein.types.common import ActionSpec, Trajectory
from freerein.types.orchestrator import LabelSegment

SPEC = DatasetSpec(
    fps=7,
    control_dt_s=0.15,
    cameras={"front": (6, 8, 3), "wrist": (4, 4, 1)},
    action=ActionSpec(2, 0, ("x", "y")),
    robot_type="test",
    skills=("lift", "reach"),
    has_terminations=True,
    robot_state_size=3,
)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A dataset `rolled` in the data directory, with true labels and the card of a policy that acted."""
    monkeypatch.setenv("FREEREIN_DATA_DIR", str(tmp_path / "var"))
    rng, root = np.random.default_rng(0), tmp_path / "var/datasets/rolled"
    with create(root, SPEC) as writer:
        for length in (3, 5):
            frames = {
                name: rng.integers(256, size=(length, *size), dtype=np.uint8) for name, size in SPEC.cameras.items()
            }
            actions, state = (rng.uniform(-1, 1, (length, size)).astype(np.float32) for size in (2, 3))
            over = np.arange(length) == length - 1
            rolled = Trajectory(frames, actions, skills=("lift",), goal_text=f"take {length}", terminated=over)
            writer.append(rolled, np.zeros(length, np.int64), robot_state=state)
    save_teachers(root, [{"supervision": "goal text"}])
    return root


def run(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["dataset", *map(str, words)])
    return result.exit_code, result.output


def test_what_is_exported_is_imported_again_to_the_bit(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "given/away"
    assert run("export", "rolled", "--to", folder) == (
        0,
        f"2 trajectories of rolled are in {folder}, which LeRobot opens.\n",
    )
    assert sorted(path.name for path in folder.iterdir()) == ["data", "meta", "teachers.json"]
    assert json.loads((folder / "meta/info.json").read_bytes())["fps"] == 7
    assert run("import", folder, "again")[0] == 0
    ours, theirs = Dataset(root), Dataset(root.parent / "again")
    assert read_teachers(root.parent / "again") == read_teachers(root) != []
    assert (theirs.spec.control_dt_s, theirs.spec.skills, theirs.goal_texts) == (0.15, ("lift",), ours.goal_texts)
    for index, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        assert one.terminated is not None
        np.testing.assert_array_equal(one.actions, other.actions)
        np.testing.assert_array_equal(one.terminated, other.terminated)
        np.testing.assert_array_equal(ours.robot_state(index), theirs.robot_state(index))
        for camera, frames in one.frames.items():
            np.testing.assert_array_equal(frames, other.frames[camera])
    assert list(truth.stored(root.parent / "again")) == []


def test_a_damaged_file_or_a_full_folder_is_refused_and_nothing_is_left(root: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").touch()
    assert "must be new or empty" in run("export", "rolled", "--to", tmp_path / "full")[1]
    path = root / "data/chunk-000/file-001.parquet"
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    code, said = run("export", "rolled", "--to", tmp_path / "new")
    assert (code, "Trajectory 1 must be as it was recorded" in said) == (1, True)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["full", "var"]


def test_what_people_gave_a_dataset_is_not_lost_in_silence_where_it_is_replaced(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "given"
    assert run("export", "rolled", "--to", folder)[0] == 0
    hand_labels.save(root, 0, [LabelSegment(0, 3, "lift")], known=["lift"])
    status, said = run("import", folder, "rolled", "--replace")
    assert (status, "no labels that a person gave" in " ".join(said.split())) == (1, True)
    assert hand_labels.count(root) == 1

    next((root / "hand_labels").iterdir()).unlink()
    status, said = run("import", folder, "rolled", "--replace")
    assert (status, "had true labels of its own: give them again" in " ".join(said.split())) == (0, True)


def test_features_are_chosen_of_other_programs_datasets_alone(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "given"
    assert run("export", "rolled", "--to", folder)[0] == 0
    for words, says in ((("--cameras", "nonsense"), "freerein wrote this one"), (("--fps", 30), "--fps must be given")):
        status, said = run("import", folder, "again", *words)
        assert (status, says in " ".join(said.split())) == (1, True)
    assert run("verify", folder)[0] == run("export", "rolled", "--to", tmp_path / "Given Away")[0] == 0
    assert run("verify", tmp_path / "Given Away")[0] == 0
