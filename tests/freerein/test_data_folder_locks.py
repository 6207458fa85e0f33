"""What a killed process left unfinished is deleted by the next one; what a living one is writing is not."""

import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.data.cache import StepCache, open_or_build
from freerein.data.folder_locks import in_use, temporary_folder, unused

KILLED = """
import os, signal, sys
from pathlib import Path

import numpy as np

from freerein.data.cache import open_or_build
from freerein.data.folder_locks import temporary_folder

def parts():
    yield np.zeros((1, 1000), np.uint8)
    os.kill(os.getpid(), signal.SIGKILL)

root = Path(sys.argv[1])
with temporary_folder(root, prefix=".import-") as folder:
    (folder / "trajectories").mkdir()
    path = root / "cache" / ("a" * 16) / "actions.raw"
    open_or_build(path, dtype=np.dtype(np.uint8), shape=(1000,), lengths=np.array([2]), parts=parts())
"""


def build(root: Path, fingerprint: str, parts: Iterator[npt.NDArray[np.uint8]]) -> StepCache[np.uint8]:
    path = root / "cache" / fingerprint / "actions.raw"
    return open_or_build(path, dtype=np.dtype(np.uint8), shape=(1000,), lengths=np.array([1]), parts=parts)


def one_part() -> Iterator[npt.NDArray[np.uint8]]:
    yield np.ones((1, 1000), np.uint8)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("fingerprint", ["a" * 16, "b" * 16])
def test_what_a_killed_process_left_is_deleted(
    tmp_path: Path, fork_program: Callable[..., Any], fingerprint: str
) -> None:
    assert fork_program("tests.code", KILLED, tmp_path).process.wait(60) == -signal.SIGKILL
    assert len(names(tmp_path / "cache" / ("a" * 16))) == len(list(tmp_path.glob(".import-*"))) == 1

    build(tmp_path, fingerprint, one_part())
    with temporary_folder(tmp_path, prefix=".import-") as folder:
        assert names(tmp_path) == [folder.name, "cache"]

    assert names(tmp_path) == ["cache"]
    assert names(tmp_path / "cache") == [fingerprint]
    assert names(tmp_path / "cache" / fingerprint) == ["actions.raw"]


def test_builds_for_two_states_of_a_dataset_leave_each_other_alone(tmp_path: Path) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def slow() -> Iterator[npt.NDArray[np.uint8]]:
        begun.set()
        assert may_end.wait(30)
        yield from one_part()

    built = list[StepCache[np.uint8]]()
    builder = threading.Thread(target=lambda: built.append(build(tmp_path, "a" * 16, slow())))
    builder.start()
    assert begun.wait(30)
    build(tmp_path, "b" * 16, one_part())
    may_end.set()
    builder.join()

    assert built[0][0].sum() == 1000
    assert names(tmp_path / "cache") == ["a" * 16]


def test_a_folder_in_use_is_not_unused_and_one_that_was_deleted_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    with in_use(folder), in_use(folder):
        assert list(unused([folder, tmp_path / "missing"])) == []
    for each in unused([folder]):
        each.rmdir()
    with in_use(folder):
        assert folder.is_dir()
