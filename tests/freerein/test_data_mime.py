"""MIME's folders, written here as public loaders of the dataset read them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from freerein.data import Dataset, MimeSource, check, import_trajectories, verify
from freerein.errors import InvalidInput, NotFound, ServiceError

SECONDS, RATE = 3, 10  # of the video that `encode_video` makes


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, encode_video: Callable[..., bytes]) -> Path:
    folder = tmp_path_factory.mktemp("mime")
    for task in ("mime_stir", "Pour"):
        path = folder / task / "4329Aug02"
        path.mkdir(parents=True)
        frames = np.zeros((SECONDS * RATE, 24, 64, 3), np.uint8)
        frames[:] = np.linspace(0, 250, len(frames)).astype(np.uint8)[:, None, None, None]
        (path / "rd_kinect_rgb.mp4").write_bytes(encode_video(frames))
        angles = [f"{{'right_s0': {line / 100}, u'left_w1': -1e-1, 'head_pan': 0.0}}\n" for line in range(301)]
        (path / "joint_angles.txt").write_text("".join(angles))
        for side, value in (("left", 0.0), ("right", 100.0)):
            (path / f"{side}_gripper.txt").write_text(f"{value}\n" * 7)
    return folder


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / "mime"))


def test_a_demonstration_is_tagged_with_reach_and_its_task(folder: Path, tmp_path: Path) -> None:
    import_trajectories(MimeSource(folder, size=(12, 32)), tmp_path / "ours")

    dataset = Dataset(tmp_path / "ours")

    assert (dataset.skills, dataset.goal_texts) == ((("pour", "reach"), ("reach", "stir")), ("pour", "stir"))
    assert dataset.spec.cameras == {"kinect": (12, 32, 1)}
    assert dataset.spec.action.names == ("left_w1", "right_s0", "left_gripper", "right_gripper")
    assert dataset.lengths.tolist() == [15, 15]  # 5 timesteps a second
    trajectory = dataset[0]
    grays = trajectory.frames["kinect"].mean(axis=(1, 2, 3))
    assert np.all(np.diff(grays) > 5)
    np.testing.assert_allclose(trajectory.actions[:, 1], [*np.linspace(0, 3, 15)[1:], 3], atol=0.006)
    assert trajectory.actions[0, [0, 2, 3]].tolist() == [np.float32(-0.1), 0, 100]
    assert verify(tmp_path / "ours") == []
    assert any("'reach'" in each.sentence and "all" in each.sentence for each in check(tmp_path / "ours"))


def test_the_dissertation_s_size_is_the_default(folder: Path) -> None:
    assert MimeSource(folder).spec.cameras == {"kinect": (120, 320, 1)}


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("rd_kinect_rgb.mp4", None),
        ("rd_kinect_rgb.mp4", b"no video at all, but long enough"),
        ("left_gripper.txt", None),
        ("right_gripper.txt", b"1.0\nopen\n"),
        ("right_gripper.txt", b"nan\n"),
        ("joint_angles.txt", None),
        ("joint_angles.txt", b""),
        ("joint_angles.txt", b"{'right_s0': __import__('os').getpid()}\n"),
    ],
)
def test_a_broken_demonstration_is_named_and_nothing_is_left(
    folder: Path, tmp_path: Path, file: str, content: bytes | None
) -> None:
    path = folder / "Pour" / "4329Aug02" / file  # the first one: no other is decoded
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(ServiceError, match=rf"Pour/4329Aug02/{file}"):
        import_trajectories(MimeSource(folder), tmp_path / "data" / "ours")
    assert not list(tmp_path.glob("data/*"))


def test_a_demonstration_of_other_joints_is_named(folder: Path) -> None:
    (folder / "mime_stir/4329Aug02/joint_angles.txt").write_text("{'left_w1': 0.5}\n")
    with pytest.raises(InvalidInput, match=r"mime_stir/4329Aug02/joint_angles\.txt"):
        list(MimeSource(folder))


def test_a_folder_without_demonstrations_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        MimeSource(tmp_path)
    (tmp_path / "stir" / "1").mkdir(parents=True)
    (tmp_path / "stir" / "1" / "joint_angles.txt").write_text("[]")
    with pytest.raises(InvalidInput):
        MimeSource(tmp_path)
