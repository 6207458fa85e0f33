"""A writer killed at any point loses at most the trajectory being written."""

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from freerein.data import Dataset, DatasetSpec, create, open_writer, truth, verify
from freerein.types.common import ActionSpec, Trajectory

WRITER = """
import sys
from pathlib import Path

import numpy as np

from freerein.data import open_writer
from freerein.types.common import Trajectory

root, stop_event, stop_path = sys.argv[1:]

def stop(event, arguments):
    if event == stop_event and str(arguments[0]).endswith(stop_path):
        print("there", flush=True)
        sys.stdin.read()

sys.addaudithook(stop)
with open_writer(Path(root)) as writer:
    for index in range(1, 3):
        frames = {"front": np.full((4, 6, 8, 3), index, np.uint8)}
        actions = np.zeros((4, 2), np.float32)
        writer.append(Trajectory(frames=frames, actions=actions, skills=("push",)), np.zeros(4, np.int64))
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    spec = DatasetSpec(
        fps=10,
        cameras={"front": (6, 8, 3)},
        action=ActionSpec(size=2, choices=0, names=("x", "y")),
        robot_type="arm",
        skills=("push",),
    )
    with create(tmp_path / "demos", spec) as writer:
        writer.append(trajectory(0), np.zeros(4, np.int64))
    return tmp_path / "demos"


def trajectory(index: int) -> Trajectory:
    frames = {"front": np.full((4, 6, 8, 3), index, np.uint8)}
    return Trajectory(frames=frames, actions=np.zeros((4, 2), np.float32), skills=("push",))


@pytest.fixture
def kill_writer_at(root: Path, fork_program: Callable[..., Any]) -> Callable[[str, str], None]:
    """A function that has a writer of trajectories 1 and 2 killed when it is about to do an event to a path."""

    def kill(event: str, path: str) -> None:
        writer = fork_program("tests.code", WRITER, root, event, path)
        assert writer.stdout.readline() == "there\n"
        writer.process.send_signal(signal.SIGKILL)
        assert writer.process.wait() == -signal.SIGKILL

    return kill


def assert_whole(root: Path, *, trajectories: int) -> None:
    assert verify(root) == []
    assert json.loads((root / "meta/info.json").read_text())["total_episodes"] == trajectories
    assert truth.stored(root) == list(range(trajectories))
    assert not list(root.rglob("*.tmp"))
    dataset = Dataset(root)
    assert dataset.skills == (("push",),) * trajectories
    for index, each in enumerate(dataset):
        np.testing.assert_array_equal(each.frames["front"], trajectory(index).frames["front"])


@pytest.mark.parametrize(
    ("event", "path", "survivors"),
    [
        pytest.param("open", "truth/chunk-000/file-002.parquet.tmp", 2, id="before the labels"),
        pytest.param("open", "data/chunk-000/file-002.parquet.tmp", 2, id="between labels and data"),
        pytest.param("os.rename", "data/chunk-000/file-002.parquet.tmp", 2, id="data written, not yet named"),
        pytest.param("open", "meta/episodes/chunk-000/file-000.parquet.tmp", 3, id="between data and meta"),
        pytest.param("os.rename", "meta/info.json.tmp", 3, id="meta written, counts not yet named"),
    ],
)
def test_every_trajectory_appended_before_the_kill_is_there_and_the_open_one_is_not(
    root: Path, kill_writer_at: Callable[[str, str], None], event: str, path: str, survivors: int
) -> None:
    kill_writer_at(event, path)

    with open_writer(root) as writer:
        assert len(writer) == survivors
        assert_whole(root, trajectories=survivors)
        writer.append(trajectory(survivors), np.zeros(4, np.int64))

    assert_whole(root, trajectories=survivors + 1)


def test_a_reader_rebuilds_meta_after_the_kill(root: Path, kill_writer_at: Callable[[str, str], None]) -> None:
    kill_writer_at("open", "meta/episodes/chunk-000/file-000.parquet.tmp")
    assert [problem.where for problem in verify(root)] != []

    assert len(Dataset(root)) == 3
    assert verify(root) == []
