"""Atomic checkpoints: after a crash at any instruction, each is either complete or absent.

    <folder>/step-000000400/state.safetensors   tensors
                            state.json          everything else
                            manifest.json       sha256 of both
             step-000000500/ ...                the newest three are kept

A checkpoint is written to a temporary folder, synced and renamed. Reading verifies the manifest; when the newest
checkpoint is corrupt, the previous one is used.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from torch import Tensor

from freerein.atomic_files import TEMP_SUFFIX, fsync_folder, write_atomic
from freerein.errors import InvalidInput, OutOfStorage
from freerein.learning import tensor_files

KEPT = 3
JSON: TypeAlias = bool | int | float | str | list["JSON"] | dict[str, "JSON"] | None

_TENSORS, _DOCUMENT, _MANIFEST = "state.safetensors", "state.json", "manifest.json"
_MAX_JSON_BYTES = 1 << 20
_MAX_FAILURES = 3
_NAME = re.compile(r"step-(\d{9})")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The full state of a training run after `step` updates: its tensors by name, and everything else as a document."""

    step: int
    tensors: Mapping[str, Tensor]
    document: Mapping[str, JSON]


def save(folder: Path, checkpoint: Checkpoint) -> None:
    """Writes a checkpoint, then deletes those of later steps, which were corrupt, and all but the newest `KEPT`.

    Raises OSError when the disk is full or broken; earlier checkpoints are untouched.
    """
    folder.mkdir(parents=True, exist_ok=True)
    fsync_folder(folder.parent)
    target = folder / f"step-{checkpoint.step:09d}"
    unfinished = target.with_name(target.name + TEMP_SUFFIX)
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        _write(unfinished, checkpoint)
        if target.exists():  # a corrupt checkpoint that was skipped
            shutil.rmtree(target)
        unfinished.rename(target)
        fsync_folder(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    found = _newest_first(folder)
    later = sum(step > checkpoint.step for step, _ in found)
    for _, path in found[:later] + found[later + KEPT :]:
        shutil.rmtree(path)


class Saver:
    """Saves the checkpoints of one training in a folder; a full disk ends it after three failures in a row."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._failures = 0

    def save(self, make: Callable[[], Checkpoint], on_failure: Callable[[str], None]) -> bool:
        """Saves what `make` returns; returns whether it is on the disk. OSErrors of `make` count, too.

        `on_failure` is called with the reason where it is not.

        Raises OutOfStorage for the third failure in a row.
        """
        try:
            save(self._folder, make())
        except OSError as error:
            self._failures += 1
            on_failure(error.strerror or "The disk failed")
            if self._failures >= _MAX_FAILURES:
                raise OutOfStorage(
                    f"Checkpoints must be writable; {_MAX_FAILURES} in a row could not be written.",
                    hint="Free disk space, then resume: the training continues from its last checkpoint.",
                ) from error
            return False
        self._failures = 0
        return True


def newest(folder: Path, *, on_corrupt: Callable[[int, str], None]) -> Checkpoint | None:
    """Returns the newest intact checkpoint, None without one.

    `on_corrupt` is called with the step of each corrupt checkpoint, and the reason.
    """
    for step, path in _newest_first(folder):
        try:
            return _read(path, step)
        except (InvalidInput, OSError) as error:
            on_corrupt(step, error.detail if isinstance(error, InvalidInput) else "A file cannot be read.")
    return None


def _write(path: Path, checkpoint: Checkpoint) -> None:
    path.mkdir()
    document = json.dumps(dict(checkpoint.document), allow_nan=False).encode()
    _check_size(len(document))  # what is too large to be read must not be kept in place of what is not
    tensors = tensor_files.dump(checkpoint.tensors)
    write_atomic(path / _DOCUMENT, document)
    write_atomic(path / _TENSORS, tensors)
    hashes = {_DOCUMENT: hashlib.sha256(document).hexdigest(), _TENSORS: hashlib.sha256(tensors).hexdigest()}
    write_atomic(path / _MANIFEST, json.dumps({"files": hashes}).encode())


def _read(path: Path, step: int) -> Checkpoint:
    """Hashes and parses the same bytes, so that a file cannot change in between."""
    hashes = _object(_read_json(path / _MANIFEST)).get("files")
    document, tensors = _read_json(path / _DOCUMENT), (path / _TENSORS).read_bytes()
    found = {_DOCUMENT: hashlib.sha256(document).hexdigest(), _TENSORS: hashlib.sha256(tensors).hexdigest()}
    if hashes != found:
        raise InvalidInput(f"A checkpoint's files must match the sha256 in its manifest; got {found}.")
    return Checkpoint(step, tensor_files.parse(tensors), _object(document))


def _read_json(path: Path) -> bytes:
    _check_size(path.stat().st_size)
    return path.read_bytes()


def _check_size(size: int) -> None:
    if size > _MAX_JSON_BYTES:
        raise InvalidInput(f"A checkpoint's JSON must have at most {_MAX_JSON_BYTES} bytes; got {size}.")


def _object(data: bytes) -> dict[str, JSON]:
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidInput("A checkpoint's JSON is malformed.") from error
    if not isinstance(value, dict):
        raise InvalidInput("A checkpoint's JSON must be an object; got something else.")
    return value


def _newest_first(folder: Path) -> list[tuple[int, Path]]:
    found = [(int(match[1]), path) for path in folder.glob("step-*") if (match := _NAME.fullmatch(path.name))]
    return sorted(found, reverse=True)
