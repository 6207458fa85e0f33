"""Trajectories of people's own folders: images, videos, tables of actions and tags."""

import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from freerein.data import Dataset, FolderSource, ImageSource, check, import_trajectories, open_writer, verify
from freerein.data.recordings import find_recordings
from freerein.data.videos import joined
from freerein.errors import InvalidInput, NotFound, ServiceError
from freerein.video import VideoFrame, frames_at_rate

SIZE = (12, 16)


def draw(folder: Path, *values: int, size: tuple[int, int] = SIZE, suffix: str = "png", mode: str = "RGB") -> None:
    """Writes images 0, 1, ... of one brightness each."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, value in enumerate(values):
        pixels = np.full((*size, 3), value, np.uint8) if mode == "RGB" else np.full(size, value, np.uint8)
        PIL.Image.fromarray(pixels).save(folder / f"{index}.{suffix}")


def brightness(dataset: Dataset, index: int, camera: str = "camera") -> list[int]:
    return [int(frame.mean()) for frame in dataset[index].frames[camera]]


def imported(source: FolderSource, root: Path) -> Dataset:
    import_trajectories(source, root)
    assert verify(root) == []
    return Dataset(root)


def test_a_folder_of_images_for_each_trajectory_is_a_dataset_without_actions(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    draw(theirs / "take-10", 3, 4)
    draw(theirs / "take-2", *range(11))
    draw(theirs / ".hidden", 9)
    (theirs / "tags.csv").write_text("trajectory,skills\ntake-2,reach;pour\n")
    source = FolderSource(theirs, fps=5)
    dataset = imported(source, tmp_path / "ours")

    assert (source.names, dataset.spec.fps, dataset.spec.cameras) == (("take-2", "take-10"), 5, {"camera": (12, 16, 3)})
    assert (dataset.spec.skills, dataset.skills) == (("pour", "reach"), (("pour", "reach"), ()))
    assert source.contents == "take-2 to take-10, one camera, no actions, 1 with tags, 5 timesteps a second"
    assert [brightness(dataset, 0), brightness(dataset, 1)] == [list(range(11)), [3, 4]]
    assert (dataset[0].actions.shape, dataset.cached_actions()[1].shape) == ((11, 0), (2, 0))
    assert [each.where for each in check(tmp_path / "ours") if each.where == "actions"] == ["actions"]
    with open_writer(tmp_path / "ours") as writer:  # which rebuilds what is missing from the data files
        assert writer.append(dataset[0]) == 2


@pytest.mark.parametrize(
    ("names", "fps"),
    [
        (("2", "10"), 10),
        (("1700000000.05", "1700000000.1", "1700000000.15", "1700000001"), 20),
        (("1700000000033", "1700000000067", "1700000000100"), 30),
        (("frame-0.9", "frame-0.95", "frame-1.0"), 10),
        (("cam0_0002", "cam0_0010"), 10),
    ],
)
def test_images_are_in_the_order_of_their_numbers_or_times(tmp_path: Path, names: tuple[str, ...], fps: int) -> None:
    draw(tmp_path / "a", *range(len(names)))
    for index in reversed(range(len(names))):
        (tmp_path / "a" / f"{index}.png").rename(tmp_path / "a" / f"{names[index]}.png")
    (only,) = FolderSource(tmp_path, fps=fps)
    assert only.frames["camera"].mean(axis=(1, 2, 3)).tolist() == list(range(len(names)))


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (("1700000000.000000", "1700000000.033333", "1700000000.066667"), "10 a second, by --fps; those of `a` are 30"),
        (("1700000000.99000000", "1700000000.132000000"), "must have one number of digits after the point"),
    ],
)
def test_times_in_names_that_would_be_misread_are_refused(tmp_path: Path, names: tuple[str, ...], says: str) -> None:
    draw(tmp_path / "a", *range(len(names)))
    for index, name in enumerate(names):
        (tmp_path / "a" / f"{index}.png").rename(tmp_path / "a" / f"{name}.png")
    with pytest.raises(InvalidInput, match=says):
        FolderSource(tmp_path)


def test_tables_are_found_whatever_their_case_and_near_names_are_refused(tmp_path: Path) -> None:
    draw(tmp_path / "a", 0, 1)
    (tmp_path / "a" / "Actions.csv").write_text("x,y\n0,1\n2,3\n")
    (tmp_path / "Tags.csv").write_text("trajectory,skills\na,reach\n")
    source = FolderSource(tmp_path)
    assert (source.spec.action.size, source.spec.skills) == (2, ("reach",))
    (tmp_path / "a" / "Actions.csv").rename(tmp_path / "a" / "action.csv")
    with pytest.raises(InvalidInput, match=r"must be called `actions\.csv`"):
        FolderSource(tmp_path)


def test_images_whose_names_have_two_orders_are_refused(tmp_path: Path) -> None:
    draw(tmp_path / "a", 0, 1)
    for index, name in enumerate(("take1.9", "take1.10")):
        (tmp_path / "a" / f"{index}.png").rename(tmp_path / "a" / f"{name}.png")
    with pytest.raises(InvalidInput, match="must have one order"):
        FolderSource(tmp_path)


def test_actions_are_those_of_a_table_and_may_be_in_any_unit(tmp_path: Path) -> None:
    for name, rows in (("a", "x,y\n0.5,-1\n1,0\n"), ("b", "x,y\n0,0\n0,250\n")):
        draw(tmp_path / "theirs" / name / "front", 1, 2, mode="L")
        (tmp_path / "theirs" / name / "actions.csv").write_text(rows)
    dataset = imported(FolderSource(tmp_path / "theirs"), tmp_path / "ours")
    assert (dataset.spec.action.names, dataset.spec.has_scaled_actions) == (("x", "y"), False)
    assert dataset.spec.cameras == {"front": (12, 16, 1)}
    assert dataset[0].actions.tolist() == [[0.5, -1], [1, 0]]


def test_a_video_is_a_trajectory_at_the_rate_asked_for(tmp_path: Path, encode_video: Callable[..., bytes]) -> None:
    frames = np.broadcast_to(np.arange(0, 200, 10, dtype=np.uint8)[:, None, None, None], (20, 32, 48, 3))
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "demo.mp4").write_bytes(encode_video(frames))
    (first,) = imported(FolderSource(tmp_path / "theirs", size=(16, 24), fps=5), tmp_path / "ours")
    seen = first.frames["camera"]
    assert seen.shape == (10, 16, 24, 3)
    assert seen.mean(axis=(1, 2, 3)) == pytest.approx(frames[::2].mean(axis=(1, 2, 3)), abs=4)


@pytest.mark.parametrize(
    ("times_s", "fps", "shown"),
    [
        ([0, 0.2, 0.4, 0.6], 10, [0, 0, 1, 1, 2, 2, 3]),
        ([t / 30 for t in range(12)], 10, [0, 3, 6, 9]),
        ([round(t / 30, 3) for t in range(31)], 30, list(range(31))),
        ([1.5, 1.6, 2.0, 2.1, 2.2], 10, [0, 1, 1, 1, 1, 2, 3, 4]),
        ([7.0], 5, [0]),
    ],
    ids=["slower", "faster", "rounded to milliseconds", "with a pause", "one frame"],
)
def test_a_video_is_shown_at_its_own_times(times_s: list[float], fps: int, shown: list[int]) -> None:
    video = [VideoFrame(time_s, np.array(index, np.uint8)) for index, time_s in enumerate(times_s)]
    sampled = list(frames_at_rate(video, fps=fps, file="demo.mp4"))
    assert [int(frame.pixels) for frame in sampled] == shown
    assert [frame.time_s for frame in sampled] == pytest.approx([times_s[0] + t / fps for t in range(len(shown))])


def test_frames_are_joined_without_holding_them_twice() -> None:
    side, count = 256, 100
    tracemalloc.start()
    frames = joined((np.full((side, side, 1), index, np.uint8) for index in range(count)), (side, side, 1))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert frames[:, 0, 0, 0].tolist() == list(range(count))
    assert peak < 1.3 * frames.nbytes


def test_a_video_with_broken_times_is_refused() -> None:
    video = [VideoFrame(time_s, np.zeros(1, np.uint8)) for time_s in (0.0, 0.1, 95_443.7)]
    with pytest.raises(InvalidInput, match=r"`demo\.mp4` must have a frame at least every 60 s") as refused:
        list(frames_at_rate(video, fps=10, file="demo.mp4"))
    assert refused.value.hint


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda root: draw(root / "b", 1, size=(8, 8)), "12 x 16"),
        (lambda root: draw(root / "b" / "side", 1), "same cameras"),
        (lambda root: (root / "a" / "actions.csv").write_text("x\n1\n2\n"), "same columns"),
        (lambda root: [(root / n / "actions.csv").write_text("x\n1\n") for n in "ab"], "a line for each of 2 images"),
        (lambda root: [(root / n / "actions.csv").write_text("x\n1\nleft\n") for n in "ab"], "finite number"),
        (lambda root: (root / "tags.csv").write_text("trajectory,skills\nc,pour\n"), "Line 2, column `trajectory`"),
        (lambda root: (root / "a" / "1.png").write_bytes(b"GIF89a"), "PNG, JPEG or WebP"),
        (lambda root: (root / "a2.avi").write_bytes(b""), "`theirs/a2.avi` must be a folder of images"),
        (lambda root: (root / "a2").mkdir(), "`theirs/a2` must be a folder of images"),
        (lambda root: (root / "b" / "2.bmp").write_bytes(b""), "`b/2.bmp` must be"),
        (lambda root: [draw(root / n / "top", 1) or (root / n / "top" / "1.npy").touch() for n in "ab"], "`top/1.npy`"),
        (lambda root: draw(root / "b", 3, suffix="jpg"), "`b` must have different names for images of a timestep"),
        (lambda root: draw(root / "b" / "camera", 3), "`b` must have different names for recordings of a camera"),
    ],
)
def test_what_does_not_fit_together_is_refused_and_nothing_is_left(
    tmp_path: Path, spoil: Callable[[Path], object], words: str
) -> None:
    theirs, ours = tmp_path / "theirs", tmp_path / "data" / "ours"
    draw(theirs / "a", 1, 2)
    draw(theirs / "b", 3, 4)
    spoil(theirs)
    with pytest.raises(ServiceError) as refused:
        import_trajectories(FolderSource(theirs), ours)
    assert words in refused.value.detail
    assert refused.value.hint
    assert not list(ours.parent.glob("*"))


def test_notes_beside_recordings_are_left_alone_and_videos_of_phones_are_read(
    tmp_path: Path, encode_video: Callable[..., bytes]
) -> None:
    (tmp_path / "b.MOV").write_bytes(encode_video(np.zeros((3, 32, 48, 3), np.uint8), container="mov"))
    draw(tmp_path / "a", 1, size=(32, 48))
    for note in ("README.md", "labels.csv", "a/times.txt"):
        (tmp_path / note).touch()
    assert [len(each.actions) for each in FolderSource(tmp_path)] == [1, 3]


def test_a_folder_without_trajectories_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(NotFound, match=r"a video \(mp4 or mov\)"):
        FolderSource(tmp_path)


def test_loose_images_are_runs_of_about_a_fiftieth(tmp_path: Path) -> None:
    draw(tmp_path / "theirs", *range(100), suffix="webp")
    draw(tmp_path / "theirs" / "more", 7, size=(30, 20), mode="L")
    draw(tmp_path / "theirs" / ".thumbnails", 7)
    source = ImageSource(tmp_path / "theirs", size=(8, 8))
    assert [len(each.actions) for each in source] == [2] * 50 + [1]
    assert source.spec.cameras == {"camera": (8, 8, 3)}
    assert not source.spec.has_actions


def named(folder: Path, *names: str) -> None:
    """Writes images of these names."""
    draw(folder, 1)
    for name in names:
        (folder / f"{name}.png").write_bytes((folder / "0.png").read_bytes())
    if "0" not in names:
        (folder / "0.png").unlink()


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("left_0", "right_0", "left_1", "right_1"), "`left_0.png` and `right_0.png` have the same number"),
        (("0_rgb", "0_depth"), "`0_depth.png` and `0_rgb.png` have the same number"),
        (("0", "1", "1_mask"), "have the same number"),
        (("1", "1 (1)"), "have the same number"),
        (("img_1", "img_01"), "have the same number"),
        (("cam0_0001", "cam1_0001", "cam1_0002"), "are of different cameras"),
        (("0", "1", "cover"), "have no order"),
        (("start_0", "middle_1", "end_2"), "must have one order"),
    ],
)
def test_two_series_in_one_folder_are_refused(tmp_path: Path, names: tuple[str, ...], words: str) -> None:
    named(tmp_path / "take-1", *names)
    with pytest.raises(InvalidInput, match=words) as refused:
        FolderSource(tmp_path)
    assert "take-1" in refused.value.detail
    assert refused.value.hint


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b", "c"),
        ("2026-01-05_12-00-00", "2026-01-05_12-00-01", "2026-01-06_12-00-00"),
        ("part1_0001", "part1_0002", "part2_0001"),
        ("camera_0001", "camera_0002"),
        ("frame1of2", "frame2of2"),
    ],
)
def test_names_of_one_series_may_hold_texts_and_several_numbers(tmp_path: Path, names: tuple[str, ...]) -> None:
    named(tmp_path / "take-1", *names)
    (only,) = FolderSource(tmp_path)
    assert len(only.actions) == len(names)


@pytest.mark.parametrize(
    ("lay_out", "words"),
    [
        (lambda root: draw(root / "session" / "take", 1, 2), "`session/take` must be named like a camera"),
        (lambda root: [draw(root / "a" / f"take-{n}", 1) for n in (1, 2)], "`a/take-1` must be named like a camera"),
        (lambda root: [draw(root / s / "007", 1) for s in "ab"], "`a/007` must be named like a camera"),
        (lambda root: [draw(root / "a" / f"left-turn-{n}", 1) for n in (1, 2)], "`a/left-turn-1` must be named like"),
        (lambda root: [draw(root / s / t, *range(len(t))) for s in "ab" for t in ("pour", "reach")], "like a camera"),
        (lambda root: draw(root / "a" / "top", 1) or (root / "a" / "tags.csv").touch(), "it holds `tags.csv`"),
        (lambda root: draw(root / "a" / "top", 1) or (root / "a/top/tags.csv").touch(), "it holds `top/tags.csv`"),
        (lambda root: draw(root / "a" / "top", 1) or (root / "a/top/actions.csv").touch(), "holds `top/actions.csv`"),
        (lambda root: draw(root / "top", 1) or (root / "actions.csv").touch(), "it holds `actions.csv`"),
    ],
)
def test_a_folder_too_high_or_too_low_is_refused(tmp_path: Path, lay_out: Callable[[Path], object], words: str) -> None:
    lay_out(tmp_path)
    with pytest.raises(InvalidInput, match=words) as refused:
        FolderSource(tmp_path)
    assert "folder" in refused.value.hint


def test_a_video_in_the_folder_of_a_trajectory_must_be_named_like_a_camera_too(
    tmp_path: Path, encode_video: Callable[..., bytes]
) -> None:
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "take-1.mp4").write_bytes(encode_video(np.zeros((3, 32, 48, 3), np.uint8)))
    with pytest.raises(InvalidInput, match="`session/take-1` must be named like a camera"):
        FolderSource(tmp_path)


@pytest.mark.parametrize(
    "cameras", [("top", "side"), ("cam0", "cam1"), ("webcam-2",), ("LeftWrist", "wrist_1", "rgb_1"), ("pics",)]
)
def test_cameras_are_known_by_their_names(tmp_path: Path, cameras: tuple[str, ...]) -> None:
    for camera in cameras:
        draw(tmp_path / "take-1" / camera, 1)
    assert find_recordings(tmp_path)[0].cameras.keys() == set(cameras)


def test_a_camera_of_any_name_without_a_number_is_alike_in_all_trajectories(tmp_path: Path) -> None:
    for take in ("take-1", "take-2"):
        for camera in ("bench", "door"):
            draw(tmp_path / take / camera, 1, 2)
    source = FolderSource(tmp_path)
    assert source.contents == "take-1 to take-2, cameras bench, door, no actions, no tags, 10 timesteps a second"


def test_files_of_operating_systems_are_ignored_and_named(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    for take in ("a", "b"):
        draw(theirs / take, 1, 2)
        (theirs / take / "Thumbs.db").touch()
        (theirs / take / "._0.png").touch()
    draw(theirs / "__MACOSX" / "a", 9)
    draw(theirs / "a" / "@eaDir", 9)
    (theirs / "desktop.ini").touch()
    source = FolderSource(theirs)
    assert brightness(imported(source, tmp_path / "ours"), 0) == [1, 2]
    assert source.names == ("a", "b")
    assert source.notes == (
        "Ignored what operating systems left: @eaDir (1), Thumbs.db (2), __MACOSX (1), desktop.ini (1).",
    )
    assert sum(len(each.actions) for each in ImageSource(theirs)) == 4


def test_all_files_that_are_not_read_are_named_at_once(tmp_path: Path) -> None:
    for take in ("a", "b"):
        draw(tmp_path / take, 1)
        for name in ("1.bmp", "2.heic"):
            (tmp_path / take / name).touch()
    with pytest.raises(InvalidInput, match=r"`a/1\.bmp`, `a/2\.heic`, `b/1\.bmp` and 1 others must be"):
        FolderSource(tmp_path)


def test_videos_of_several_sizes_are_refused_and_with_a_size_it_is_said_what_is_stretched(
    tmp_path: Path, encode_video: Callable[..., bytes]
) -> None:
    for name, (height, width) in (("a", (64, 96)), ("b", (96, 64))):
        (tmp_path / f"{name}.mp4").write_bytes(encode_video(np.zeros((2, height, width, 3), np.uint8)))
    with pytest.raises(InvalidInput, match=r"must be 64 x 96, as the first; `.*b\.mp4` is 96 x 64"):
        list(FolderSource(tmp_path))
    source = FolderSource(tmp_path, size=(32, 48))
    assert [each.frames["camera"].shape for each in source] == [(2, 32, 48, 3)] * 2
    assert ["Frames of `b/camera`, 96 x 64, were" in note for note in source.notes] == [True]


def test_it_is_said_which_images_a_size_stretches(tmp_path: Path) -> None:
    draw(tmp_path / "a", 1, 2)
    draw(tmp_path / "b", 1, size=(16, 12))
    source = FolderSource(tmp_path, size=(16, 12))
    assert len(list(source)) == 2
    assert [note.split(" were ")[0] for note in source.notes] == ["Frames of `a/camera`, 12 x 16,"]


def put(kind: str, path: Path) -> None:
    """Puts a pipe, or a link to a device, in the place of a file."""
    path.unlink(missing_ok=True)
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")


@pytest.mark.fault("F16")
@pytest.mark.parametrize("name", ["take/0.png", "take/top/0.png", "tags.csv", "take/actions.csv", "take/top.mp4"])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path, name: str) -> None:
    draw(tmp_path / "take" / "top" if name == "take/top/0.png" else tmp_path / "take", 1)
    for kind in ("pipe", "device"):
        put(kind, tmp_path / name)
        with pytest.raises(InvalidInput, match="must be"):
            FolderSource(tmp_path)


@pytest.mark.fault("F16")
def test_a_pipe_in_the_index_of_a_dataset_is_replaced_and_data_that_is_no_regular_file_is_refused_at_once(
    tmp_path: Path,
) -> None:
    draw(tmp_path / "theirs" / "take", 1)
    imported(FolderSource(tmp_path / "theirs"), tmp_path / "ours")
    for name in ("info.json", "episodes/chunk-000/file-000.parquet"):
        put("pipe", tmp_path / "ours" / "meta" / name)
        assert brightness(Dataset(tmp_path / "ours"), 0) == [1]
        assert (tmp_path / "ours" / "meta" / name).is_file()
    for kind in ("pipe", "device"):
        put(kind, tmp_path / "ours" / "data" / "chunk-000" / "file-000.parquet")
        assert [each.where for each in verify(tmp_path / "ours")][:1] == ["data/chunk-000/file-000.parquet"]
        with pytest.raises(InvalidInput, match=f"must be a regular file; it is a {kind}"):
            Dataset(tmp_path / "ours")[0]


@pytest.mark.parametrize(
    ("size", "scaled"),
    [((720, 1280), (128, 228)), ((400, 300), (171, 128)), ((40, 40), (128, 128)), ((9, 100), (128, 1024))],
)
def test_loose_images_keep_the_proportions_of_the_first(
    size: tuple[int, int], scaled: tuple[int, int], tmp_path: Path
) -> None:
    draw(tmp_path, 1, 2, size=size)
    draw(tmp_path / "more", 3, size=(30, 20))
    source = ImageSource(tmp_path)
    assert source.spec.cameras == {"camera": (*scaled, 3)}
    assert {each.frames["camera"].shape[1:] for each in source} == {(*scaled, 3)}
    assert [f"were stretched to {scaled[0]} x {scaled[1]}" in note for note in source.notes] == [True]


def test_two_images_are_held_apart_and_one_is_refused(tmp_path: Path) -> None:
    draw(tmp_path / "two", 1, 2)
    assert [len(each.actions) for each in ImageSource(tmp_path / "two")] == [1, 1]
    draw(tmp_path / "one", 1)
    with pytest.raises(NotFound, match="at least 2; it holds 1"):
        ImageSource(tmp_path / "one")


def test_a_table_of_numbers_names_its_file(tmp_path: Path) -> None:
    draw(tmp_path / "a", 1)
    (tmp_path / "a" / "actions.csv").write_text("1\nleft\n")
    with pytest.raises(InvalidInput, match=r"`a/actions\.csv`"):
        FolderSource(tmp_path)
