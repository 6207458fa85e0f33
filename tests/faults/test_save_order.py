"""What is acknowledged is on the disk: data, then the rename, then its folder, each synced before the next.

SIGKILL cannot test this, for the kernel keeps what a killed process has written; so the calls themselves are checked.
"""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("O4")]
Call = tuple[str, ...]
HOOKED = Path(__file__).with_name("hooked_saves.py")
SAVED = "acknowledged"
LINE = re.compile(
    r"(?:\d+ +)?(?P<name>openat|mkdir|fsync|rename)\((?:AT_FDCWD<[^>]*>, |\d+<(?P<synced>[^>]*)>)?(?P<rest>.*)\) += \d"
)


def check(calls: Iterable[Call]) -> int:
    """Raises AssertionError unless whatever a call acknowledges was synced before; returns the number of renames."""
    files: set[str] = set()
    folders: set[str] = set()
    renames = 0
    for name, path, *more in calls:
        match name:
            case "open" if path.endswith(SAVED):
                assert not files | folders, "acknowledged before it was synced"
            case "open" if not path.endswith("lock"):
                files.add(path)
            case "mkdir":
                folders.add(str(Path(path).parent))
            case "fsync":
                files.discard(path)
                folders.discard(path)
            case "rename":
                assert not [file for file in files if file == path or file.startswith(f"{path}/")], "renamed too early"
                folders = {each for each in folders if not each.startswith(path)} | {str(Path(more[0]).parent)}
                renames += 1
    return renames


def by_strace(root: Path, tmp_path: Path) -> list[Call]:
    """Returns the system calls that write below a folder."""
    if shutil.which("strace") is None:
        pytest.skip("needs strace")
    trace = tmp_path / "trace"
    command = ["strace", "-f", "--seccomp-bpf"]  # it stops for no other call: to import torch makes thousands
    command += ["-y", "-qq", "-e", "trace=openat,mkdir,fsync,rename", "-o", str(trace)]
    subprocess.run([*command, sys.executable, str(HOOKED), str(root)], check=True)
    return [call for line in trace.read_text().splitlines() if (call := parsed(line)) and call[1].startswith(str(root))]


def parsed(line: str) -> Call | None:
    """Returns the call of a line of strace; None for one that failed, or opens a file to read it."""
    found = LINE.match(line)
    if found is None or (found["name"] == "openat" and not re.search(r"O_WRONLY|O_RDWR", line)):
        return None
    name = {"openat": "open"}.get(found["name"], found["name"])
    return (name, found["synced"]) if found["synced"] else (name, *re.findall(r'"([^"]*)"', found["rest"]))


@pytest.fixture
def by_hooks(run_child: Callable[..., tuple[int, str]]) -> Callable[[Path, Path], list[Call]]:
    """Returns the calls of Python's own functions that write below a folder."""

    def trace(root: Path, tmp_path: Path) -> list[Call]:
        log = tmp_path / "calls"
        assert run_child("tests.faults.hooked_saves", root, log) == (0, "")
        calls = [tuple(json.loads(line)) for line in log.read_text().splitlines()]
        return [call for call in calls if call[1].startswith(str(root))]

    return trace


def test_data_are_synced_before_a_rename_and_folders_before_the_acknowledgement(
    by_hooks: Callable[[Path, Path], list[Call]], tmp_path: Path
) -> None:
    check_all(by_hooks, tmp_path)


@pytest.mark.long
def test_the_kernel_is_asked_for_it_too(tmp_path: Path) -> None:
    check_all(by_strace, tmp_path)


def check_all(traced: Callable[[Path, Path], list[Call]], tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    calls = traced(tmp_path / "root", tmp_path)
    assert check(calls) == 10  # 4 of a checkpoint, 2 of a job, 3 of a model, and which is active
    assert sum(call[1].endswith(SAVED) for call in calls) == 5


@pytest.mark.parametrize("forgotten", [("fsync", "/r/a.tmp"), ("fsync", "/r")])
def test_a_sync_that_was_forgotten_is_found(forgotten: Call) -> None:
    calls = [
        ("open", "/r/a.tmp"),
        ("fsync", "/r/a.tmp"),
        ("rename", "/r/a.tmp", "/r/a"),
        ("fsync", "/r"),
        ("open", SAVED),
    ]
    assert check(calls) == 1
    with pytest.raises(AssertionError):
        check(call for call in calls if call != forgotten)
