"""LeRobotDataset v3 with video, written here as LeRobot lays it out: several trajectories to a file, H.264 or AV1."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from freerein.data import Dataset, LeRobotOptions, LeRobotSource, check, import_trajectories, imported, verify
from freerein.errors import AlreadyExists, InvalidInput, ServiceError

FPS, HEIGHT, WIDTH = 10, 48, 64
LENGTHS = (5, 7, 4)
FILES = (0, 0, 1)
STARTS_S = (0.0, 0.5 + 1e-7, 0.0)  # LeRobot adds up durations: they are not exact
SKILLS = (["push"], ["pick", "push"], [])
KEY = "observation.images.top"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = f"videos/{KEY}/chunk-000/file-{{}}.mp4"


def moving_square(file: int) -> np.ndarray:
    """Returns the frames of a video file, (T, H, W, 3): a white square moves to the right, two pixels a frame."""
    count = sum(length for length, each in zip(LENGTHS, FILES, strict=True) if each == file)
    frames = np.zeros((count, HEIGHT, WIDTH, 3), np.uint8)
    for t, frame in enumerate(frames):
        frame[20:28, 2 * t : 2 * t + 8] = 255
    return frames


def square_at(frame: np.ndarray) -> int:
    """Returns the left side of the square."""
    return int(np.flatnonzero(frame[24, :, 0] > 128)[0])


def encode(path: Path, frames: np.ndarray, *, codec: str = "libx264", fps: int = FPS) -> None:
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps)
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


ACTIONS = np.random.default_rng(0).uniform(-300, 900, (sum(LENGTHS), 2)).astype(np.float32)
INFO: dict[str, Any] = {
    "codebase_version": "v3.0",
    "robot_type": "arm",
    "total_episodes": 3,
    "total_frames": sum(LENGTHS),
    "total_tasks": 1,
    "chunks_size": 1000,
    "fps": FPS,
    "splits": {"train": "0:3"},
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    "features": {
        KEY: {
            "dtype": "video",
            "shape": [HEIGHT, WIDTH, 3],
            "names": ["height", "width", "channels"],
            "info": {"video.codec": "h264", "video.fps": FPS, "video.is_depth_map": False},
        },
        "observation.images.depth": {
            "dtype": "video",
            "shape": [HEIGHT, WIDTH, 1],
            "names": ["height", "width", "channels"],
            "info": {"video.is_depth_map": True},
        },
        "action": {"dtype": "float32", "shape": [2], "names": ["pan", "lift"]},
    },
}


def write_episodes(root: Path, **changes: Any) -> None:
    lengths = np.array(LENGTHS)
    columns: dict[str, Any] = {
        "episode_index": [0, 1, 2],
        "tasks": [["tidy"]] * 3,
        "length": lengths,
        "data/chunk_index": [0] * 3,
        "data/file_index": [0] * 3,
        f"videos/{KEY}/chunk_index": [0] * 3,
        f"videos/{KEY}/file_index": list(FILES),
        f"videos/{KEY}/from_timestamp": list(STARTS_S),
        f"videos/{KEY}/to_timestamp": list(np.array(STARTS_S) + lengths / FPS),
        "skills": list(SKILLS),
    }
    (root / EPISODES).parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns | changes), root / EPISODES)


def write_info(root: Path, **changes: Any) -> None:
    (root / "meta/info.json").write_text(json.dumps(INFO | changes))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("made") / "theirs"
    write_episodes(root)
    write_info(root)
    pq.write_table(pa.table({"task_index": [0], "task": ["tidy"]}), root / "meta/tasks.parquet")
    rows = {
        "action": pa.array(ACTIONS.tolist(), pa.list_(pa.float32())),
        "episode_index": np.repeat(np.arange(3), LENGTHS),
    }
    (root / "data/chunk-000").mkdir(parents=True)
    pq.write_table(pa.table(rows), root / "data/chunk-000/file-000.parquet")
    for file in range(2):
        encode(root / VIDEO.format(f"{file:03d}"), moving_square(file))
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "theirs"))


SQUARES = ([0, 2, 4, 6, 8], [10, 12, 14, 16, 18, 20, 22], [0, 2, 4, 6])


def test_frames_of_av1_are_those_of_their_times(root: Path) -> None:
    for file in range(2):
        encode(root / VIDEO.format(f"{file:03d}"), moving_square(file), codec="libsvtav1")
    assert [list(map(square_at, each.frames["top"])) for each in Dataset(root)] == list(SQUARES)


def test_every_frame_is_that_of_its_time(root: Path) -> None:
    dataset = Dataset(root)
    assert dataset.spec.cameras == {"top": (HEIGHT, WIDTH, 3)}  # depth is left out
    assert [list(map(square_at, each.frames["top"])) for each in dataset] == list(SQUARES)
    assert [list(map(square_at, dataset[index].frames["top"])) for index in (2, 0, 1)] == [SQUARES[2], *SQUARES[:2]]
    assert list(map(square_at, dataset.cached_frames("top")[1])) == SQUARES[1]
    assert [square_at(frame) for frame in dataset.first_frames([1, 2], "top")] == [10, 0]
    assert [each for each in check(root) if each.where != "skills"] == []  # actions in any unit are no problem


def test_an_import_keeps_everything_in_the_layout_of_ours(root: Path, tmp_path: Path) -> None:
    counts = list[int]()
    with imported(LeRobotSource(root, size=(24, 32)), tmp_path / "ours", on_count=counts.append):
        ours = Dataset(tmp_path / "ours")

    assert (counts, verify(tmp_path / "ours")) == ([1, 2, 3], [])
    assert (ours.spec.cameras, ours.spec.fps, ours.spec.robot_type) == ({"top": (24, 32, 3)}, FPS, "arm")
    assert (ours.skills, ours.goal_texts) == ((("push",), ("pick", "push"), ()), ("tidy",) * 3)
    np.testing.assert_array_equal(np.concatenate([each.actions for each in ours]), ACTIONS)
    assert [[int(np.flatnonzero(f[12, :, 0] > 128)[0]) for f in each.frames["top"]] for each in ours] == [
        [x // 2 for x in squares] for squares in SQUARES
    ]
    with pytest.raises(AlreadyExists):
        import_trajectories(LeRobotSource(root), tmp_path / "ours")


def test_the_fingerprint_is_of_the_frames_too(root: Path) -> None:
    before = Dataset(root).fingerprint
    encode(root / VIDEO.format("001"), moving_square(1)[::-1])
    assert Dataset(root).fingerprint != before


FIRST, SECOND, ROWS = VIDEO.format("000"), VIDEO.format("001"), "data/chunk-000/file-000.parquet"


def cut(path: Path, count: int) -> None:
    path.write_bytes(path.read_bytes()[:-count])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda root: (root / SECOND).unlink(), "file-001.mp4` must be in the dataset"),
        (lambda root: cut(root / SECOND, 200), "file-001.mp4` must be a complete mp4"),
        (lambda root: encode(root / SECOND, moving_square(1).swapaxes(1, 2)), "declares, 48 x 64; they are 64 x 48"),
        (lambda root: encode(root / SECOND, moving_square(1)[:3]), "0.300 s, number 3 of 4 of a trajectory; the video"),
        (
            lambda root: encode(root / FIRST, moving_square(0), fps=7),
            "0.100 s, number 1 of 5 of a trajectory; the",
        ),
        (lambda root: cut(root / ROWS, 20), "truncated or corrupt"),
        (lambda root: pq.write_table(pq.read_table(root / ROWS).slice(1), root / ROWS), "must have the 5 timesteps"),
    ],
)
def test_what_is_damaged_is_refused_and_nothing_is_left_of_it(
    root: Path, tmp_path: Path, damage: Callable[[Path], object], words: str
) -> None:
    damage(root)
    with pytest.raises(ServiceError) as caught:
        import_trajectories(LeRobotSource(root), tmp_path / "data" / "ours")
    assert words in caught.value.detail
    assert list((tmp_path / "data").iterdir()) == []


def test_an_episodes_table_that_contradicts_itself_is_refused(root: Path) -> None:
    for column, values in (
        (f"videos/{KEY}/to_timestamp", [0.5, 1.1, 0.4]),
        (f"videos/{KEY}/to_timestamp", [0.5, float("nan"), 0.4]),
        (f"videos/{KEY}/from_timestamp", [None, 0.5, 0.0]),
        (f"videos/{KEY}/file_index", ["../../x", "0", "0"]),
        ("data/file_index", ["../../x", "0", "0"]),
    ):
        write_episodes(root, **{column: values})
        with pytest.raises(InvalidInput):
            Dataset(root)


def test_no_file_outside_of_the_dataset_is_named(root: Path) -> None:
    changes: dict[str, Any]
    for changes in (
        {"video_path": "../../{video_key}.mp4"},
        {"features": {"observation.images.../../up": INFO["features"][KEY], "action": INFO["features"]["action"]}},
        {"features": {"/etc/up": INFO["features"][KEY], "action": INFO["features"]["action"]}},
    ):
        write_info(root, **changes)
        with pytest.raises(InvalidInput):
            Dataset(root)


def test_frames_are_those_of_the_episode_after_another_was_deleted(root: Path, tmp_path: Path) -> None:
    pq.write_table(pq.read_table(root / EPISODES).take([1, 2]), root / EPISODES)
    import_trajectories(LeRobotSource(root), tmp_path / "ours")
    for dataset in (Dataset(root), Dataset(tmp_path / "ours")):
        assert [list(map(square_at, each.frames["top"])) for each in dataset] == [*SQUARES[1:]]
    assert verify(root) == []


def test_what_is_damaged_is_skipped_and_the_rest_of_its_video_is_read(root: Path, tmp_path: Path) -> None:
    write_episodes(root, **{f"videos/{KEY}/to_timestamp": [0.9, 1.2 + 1e-7, 0.4]})
    encode(root / VIDEO.format("001"), moving_square(1)[:2])
    source = LeRobotSource(root, options=LeRobotOptions(skip_damaged=True))
    import_trajectories(source, tmp_path / "ours")
    ours = Dataset(tmp_path / "ours")
    assert [list(map(square_at, each.frames["top"])) for each in ours] == [SQUARES[1]]
    assert any("`episode 0` is left out" in each for each in source.notes)
    assert "1 of 2 trajectories are damaged and left out:" in source.notes
