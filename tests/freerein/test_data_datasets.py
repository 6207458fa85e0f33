"""Writing, reading, caching."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from freerein.data import (
    Dataset,
    DatasetSpec,
    Writer,
    create,
    dataset_path,
    inspect,
    integer_fps,
    open_writer,
    truth,
    verify,
)
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound
from freerein.types.common import ActionSpec, Trajectory

SPEC = DatasetSpec(
    fps=20,
    cameras={"front": (6, 8, 3), "wrist": (4, 5, 1)},
    action=ActionSpec(size=3, choices=0, names=("x", "y", "z")),
    robot_type="arm",
    skills=("push", "pick"),
    task="tidy the desk",
)
WITH_TERMINATIONS = replace(SPEC, has_terminations=True)
DISCRETE = replace(SPEC, action=ActionSpec(size=1, choices=3, names=("left", "right", "forward")))


def trajectory(index: int, *, skills: tuple[str, ...] = ()) -> Trajectory:
    rng, length = np.random.default_rng(index), 4 + index
    frames = {name: rng.integers(0, 256, (length, *size), dtype=np.uint8) for name, size in SPEC.cameras.items()}
    return Trajectory(frames=frames, actions=rng.uniform(-1, 1, (length, 3)).astype(np.float32), skills=skills)


def discrete(index: int) -> Trajectory:
    return replace(trajectory(index), actions=np.random.default_rng(index).integers(0, 3, (4 + index, 1)))


def crash(index: int) -> Trajectory:
    """Returns a trajectory that ends with a crash if its index is odd."""
    terminated = np.zeros(4 + index, np.bool_)
    terminated[-1] = index % 2
    return replace(trajectory(index), terminated=terminated)


def assert_equal(got: Trajectory, expected: Trajectory) -> None:
    assert got.skills == expected.skills
    assert got.actions.dtype == expected.actions.dtype
    np.testing.assert_array_equal(got.actions, expected.actions)
    assert got.frames.keys() == expected.frames.keys()
    for camera, frames in expected.frames.items():
        assert got.frames[camera].dtype == np.uint8
        np.testing.assert_array_equal(got.frames[camera], frames)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "datasets" / "demos"


@pytest.fixture
def writer(root: Path) -> Writer:
    with create(root, SPEC) as writer:
        yield writer


def test_trajectories_come_back_as_they_were_appended(root: Path, writer: Writer) -> None:
    expected = [trajectory(0, skills=("pick", "push")), trajectory(1), trajectory(2, skills=("push",))]
    assert [writer.append(each) for each in expected] == [0, 1, 2]
    writer.close()

    dataset = Dataset(root)

    assert dataset.spec == SPEC
    assert dataset.skills == (("pick", "push"), (), ("push",))
    assert dataset.lengths.tolist() == [4, 5, 6]
    for got, each in zip(dataset, expected, strict=True):
        assert_equal(got, each)
    assert_equal(dataset[-1], expected[2])
    with pytest.raises(IndexError):
        dataset[3]


def test_every_trajectory_may_have_a_goal_text_of_its_own(root: Path, writer: Writer) -> None:
    texts = ("push the red block", "", "lift it — straight up", "push the red block")
    for index, text in enumerate(texts):
        writer.append(replace(trajectory(index), goal_text=text))
    expected = ("push the red block", SPEC.task, "lift it — straight up", "push the red block")

    assert Dataset(root).goal_texts == expected  # from the data files alone: `meta/` comes with `close`
    writer.close()
    assert Dataset(root).goal_texts == tuple(each.goal_text for each in Dataset(root)) == expected
    assert inspect(root).goal_text_counts == {"push the red block": 2, SPEC.task: 1, "lift it — straight up": 1}


def test_meta_is_rebuilt_from_the_data_files_alone(root: Path) -> None:
    with create(root, WITH_TERMINATIONS) as writer:
        for index, text in enumerate(("lift it", "push it", "lift it")):
            writer.append(replace(crash(index), goal_text=text))
    before = {path.name: path.read_bytes() for path in (root / "meta").rglob("*") if path.is_file()}
    fingerprint = Dataset(root).fingerprint
    for lost in ("", "info.json", "freerein.json", "stats.json", "tasks.parquet", "episodes"):
        path = root / "meta" / lost
        (shutil.rmtree if path.is_dir() else Path.unlink)(path)
        assert Dataset(root).fingerprint == fingerprint
        assert {path.name: path.read_bytes() for path in (root / "meta").rglob("*") if path.is_file()} == before
    assert verify(root) == []


def test_discrete_actions_come_back_as_they_were_appended(root: Path) -> None:
    with create(root, DISCRETE) as writer:
        writer.append(discrete(0))

    assert_equal(Dataset(root)[0], discrete(0))
    np.testing.assert_array_equal(Dataset(root).cached_actions()[0], discrete(0).actions)


def test_terminations_come_back_as_they_were_appended(root: Path) -> None:
    with create(root, WITH_TERMINATIONS) as writer:
        for index in range(3):
            writer.append(crash(index))
    dataset = Dataset(root)

    assert dataset.spec == WITH_TERMINATIONS
    for index in range(3):
        got = dataset[index].terminated
        assert got is not None
        assert (got.dtype, got.tolist()) == (np.bool_, crash(index).terminated.tolist())
    assert verify(root) == []


def test_terminations_are_unknown_where_the_spec_has_none(root: Path, writer: Writer) -> None:
    writer.append(trajectory(0))
    assert Dataset(root)[0].terminated is None


def test_terminations_that_are_not_as_the_spec_says_are_refused(tmp_path: Path, writer: Writer) -> None:
    wrong = [np.zeros(3, np.bool_), np.zeros((4, 1), np.bool_), np.zeros(4, np.int64)]
    with create(tmp_path / "others", WITH_TERMINATIONS) as other:
        refused = [(writer, crash(0)), *((other, replace(crash(0), terminated=each)) for each in (None, *wrong))]
        for its_writer, unfit in refused:
            with pytest.raises(InvalidInput) as caught:
                its_writer.append(unfit)
            assert (caught.value.field, len(its_writer)) == ("terminated", 0)


def test_a_dataset_can_be_extended_later(root: Path, writer: Writer) -> None:
    writer.append(trajectory(0))
    writer.close()

    with open_writer(root) as again:
        assert (len(again), again.spec) == (1, SPEC)
        assert again.append(trajectory(1)) == 1

    assert_equal(Dataset(root)[1], trajectory(1))


def test_a_reader_beside_the_writer_sees_every_trajectory_appended_so_far(root: Path, writer: Writer) -> None:
    writer.append(trajectory(0))
    early = Dataset(root)
    writer.append(trajectory(1))

    assert len(early) == 1
    assert_equal(Dataset(root)[1], trajectory(1))


def test_a_dataset_has_one_writer_at_a_time(root: Path, writer: Writer) -> None:
    with pytest.raises(FailedPrecondition):
        open_writer(root)
    writer.close()
    open_writer(root).close()


def test_a_closed_writer_appends_nothing(writer: Writer) -> None:
    writer.close()
    with pytest.raises(FailedPrecondition):
        writer.append(trajectory(0))


def test_a_name_that_is_taken_makes_no_dataset(root: Path, writer: Writer) -> None:
    with pytest.raises(AlreadyExists):
        create(root, SPEC)
    assert [path.name for path in root.parent.iterdir()] == ["demos"]


def test_what_is_no_dataset_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        Dataset(tmp_path)
    with pytest.raises(NotFound):
        open_writer(tmp_path / "absent")


def test_a_trajectory_that_is_not_as_the_spec_says_is_refused(root: Path, writer: Writer) -> None:
    for field, wrong in (
        ("actions", replace(trajectory(0), actions=np.zeros((4, 2), np.float32))),
        ("actions", replace(trajectory(0), actions=np.zeros((4, 3), np.float64))),
        ("actions", replace(trajectory(0), actions=np.full((4, 3), np.nan, np.float32))),
        ("actions", replace(trajectory(0), actions=np.full((4, 3), 1.1, np.float32))),
        ("actions", replace(trajectory(0), actions=np.zeros((0, 3), np.float32))),
        ("frames", replace(trajectory(0), frames={"front": np.zeros((4, 6, 8, 3), np.uint8)})),
        ("frames.front", replace(trajectory(0), frames=trajectory(1).frames)),
        ("skills", replace(trajectory(0), skills=("fly",))),
        ("skills", replace(trajectory(0), skills=("push", "pick"))),
        ("goal_text", replace(trajectory(0), goal_text="x" * 2001)),
        ("goal_text", replace(trajectory(0), goal_text="half a pair \ud800")),
    ):
        with pytest.raises(InvalidInput) as caught:
            writer.append(wrong)
        assert caught.value.field == field
    assert not list((root / "data").rglob("*.parquet"))


def test_labels_that_are_not_as_the_spec_says_are_refused(root: Path, writer: Writer) -> None:
    for labels in (np.zeros(3, np.int64), np.zeros(4, np.int32), np.full(4, 2), np.full(4, -1)):
        with pytest.raises(InvalidInput):
            writer.append(trajectory(0), labels)
    assert truth.stored(root) == []
    assert len(writer) == 0


def test_labels_of_an_append_that_failed_do_not_go_to_the_next_trajectory(root: Path, writer: Writer) -> None:
    in_the_way = root / "data" / "chunk-000"
    in_the_way.touch()
    with pytest.raises(FileExistsError):
        writer.append(trajectory(0), np.zeros(4, np.int64))
    in_the_way.unlink()

    assert writer.append(trajectory(1)) == 0

    assert truth.stored(root) == []


def test_the_cache_maps_every_frame_and_action(root: Path, writer: Writer) -> None:
    for index in range(3):
        writer.append(trajectory(index))
    writer.close()

    dataset = Dataset(root)
    frames, actions = dataset.cached_frames("wrist"), dataset.cached_actions()

    assert isinstance(frames.steps, np.memmap)
    assert (len(frames), frames.offsets.tolist()) == (3, [0, 4, 9, 15])
    for index in range(3):
        np.testing.assert_array_equal(frames[index], trajectory(index).frames["wrist"])
        np.testing.assert_array_equal(actions[index], trajectory(index).actions)
    with pytest.raises(ValueError, match="read-only"):
        frames.steps[0] = 0
    with pytest.raises(InvalidInput):
        dataset.cached_frames("rear")


def test_the_cache_is_built_once_and_again_when_the_data_changed(root: Path, writer: Writer) -> None:
    writer.append(trajectory(0))
    first = Dataset(root)
    built = Path(first.cached_frames("front").steps.filename)
    assert Path(Dataset(root).cached_frames("front").steps.filename).stat().st_ino == built.stat().st_ino

    writer.append(trajectory(1))
    again = Dataset(root).cached_frames("front")

    np.testing.assert_array_equal(again[1], trajectory(1).frames["front"])
    assert [path.name for path in (root / "cache").iterdir()] == [Path(again.steps.filename).parent.name]
    np.testing.assert_array_equal(first.cached_frames("front")[0], trajectory(0).frames["front"])


def test_an_empty_dataset_opens_but_cannot_be_cached(root: Path, writer: Writer) -> None:
    assert len(Dataset(root)) == 0
    with pytest.raises(InvalidInput):
        Dataset(root).cached_frames("front")


def test_the_fingerprint_is_of_the_contents(tmp_path: Path) -> None:
    for name, index in (("one", 0), ("same", 0), ("other", 1)):
        with create(tmp_path / name, SPEC) as writer:
            writer.append(trajectory(index))
    one, same, other = (Dataset(tmp_path / name).fingerprint for name in ("one", "same", "other"))
    assert one == same
    assert one != other


def test_the_summary_counts_what_is_there(root: Path, writer: Writer) -> None:
    writer.append(trajectory(0, skills=("pick", "push")), np.array([0, 0, 1, 1]))
    writer.append(trajectory(1, skills=("push",)))
    writer.append(trajectory(2))
    writer.close()

    summary = inspect(root)

    assert (summary.trajectories, summary.frames, summary.duration_s) == (3, 15, 0.75)
    assert (summary.shortest, summary.longest) == (4, 6)
    assert summary.skill_counts == {"push": 2, "pick": 1}
    assert (summary.untagged, summary.labelled) == (1, 1)


def test_a_name_leads_below_the_data_directory_and_what_is_no_name_to_no_path(tmp_path: Path) -> None:
    for name in ("", "..", "../demos", "a/b", "/etc", "Demos", ".hidden", "demos\n", "x" * 65):
        with pytest.raises(InvalidInput):
            dataset_path(tmp_path, name)
    assert dataset_path(tmp_path, "blocks-demos.v2") == tmp_path / "datasets" / "blocks-demos.v2"


def test_the_rate_is_the_nearest_integer() -> None:
    assert [integer_fps(dt) for dt in (0.05, 1 / 30, 0.3)] == [20, 30, 3]
    with pytest.raises(InvalidInput):
        integer_fps(0)
