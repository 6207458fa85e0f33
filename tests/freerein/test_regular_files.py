"""Files that people bring: what is opened, and what is refused without waiting for it."""

import os
import socket
from pathlib import Path

import pytest

from freerein.errors import InvalidInput
from freerein.regular_files import open_regular, read_regular


def test_a_regular_file_is_read_and_so_is_one_that_a_link_leads_to(tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_bytes(b"1,2")
    (tmp_path / "link.csv").symlink_to("table.csv")
    assert [read_regular(tmp_path / name, name=name) for name in ("table.csv", "link.csv")] == [b"1,2"] * 2


@pytest.mark.fault("F16")
@pytest.mark.parametrize("kind", ["a pipe", "a device", "a socket", "a folder"])
def test_another_kind_of_file_is_refused_by_its_kind(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "0.png"
    with socket.socket(socket.AF_UNIX) as listener:
        match kind:
            case "a pipe":
                os.mkfifo(path)
            case "a device":
                path.symlink_to("/dev/zero")
            case "a socket":
                listener.bind(str(path))
            case _:
                path.mkdir()
        with pytest.raises(InvalidInput, match=f"`take/0.png` must be a regular file; it is {kind}"):
            open_regular(path, name="take/0.png")
        assert path.resolve() not in [each.resolve() for each in Path("/proc/self/fd").iterdir()]


@pytest.mark.fault("F16")
def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "tags.csv").open("wb") as file:
        file.truncate(2**41)  # takes no room on the disk
    with pytest.raises(InvalidInput, match=r"`tags\.csv` must have at most 64 MiB"):
        read_regular(tmp_path / "tags.csv", name="tags.csv")


def test_a_missing_file_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "none", name="none")
