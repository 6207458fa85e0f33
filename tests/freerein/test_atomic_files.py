"""Errors of a disk: what callers can act on, and what stays a bug."""

import errno
import os
from pathlib import Path

import pytest

from freerein.atomic_files import storage_errors
from freerein.errors import OutOfStorage


@pytest.mark.fault("C21")
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS, errno.EACCES])
def test_a_disk_that_refuses_is_out_of_storage_with_the_reason_and_without_a_path(number: int, tmp_path: Path) -> None:
    with pytest.raises(OutOfStorage) as refused, storage_errors():
        raise OSError(number, os.strerror(number), str(tmp_path))
    assert os.strerror(number) in refused.value.detail
    assert str(tmp_path) not in refused.value.detail
    assert "idempotency key" in refused.value.hint


def test_a_file_that_is_missing_stays_a_bug(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), storage_errors():
        (tmp_path / "none").read_bytes()
