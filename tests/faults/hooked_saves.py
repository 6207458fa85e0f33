"""Saves a checkpoint, a job and a model below a folder: `python hooked_saves.py FOLDER [FILE FOR THE CALLS]`."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import torch

from freerein.atomic_files import write_atomic
from freerein.jobs.store import JobStore
from freerein.learning import checkpoints
from freerein.model_store import ModelStore


def write_down_calls(path: str) -> None:
    """Writes opens for writing, new folders, renames and syncs of this process to a file."""
    log, fsync = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND), os.fsync

    def note(*call: object) -> None:
        os.write(log, json.dumps([str(each) for each in call]).encode() + b"\n")

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR):
            note("open", arguments[0])
        if event in ("os.mkdir", "os.rename"):
            note(event.removeprefix("os."), *arguments[: 1 if event == "os.mkdir" else 2])

    def noted_fsync(descriptor: int) -> None:
        fsync(descriptor)
        note("fsync", Path(f"/proc/self/fd/{descriptor}").readlink())

    sys.addaudithook(hook)
    os.fsync = noted_fsync  # the one call without an audit event


def save_all(root: Path) -> None:
    """Saves each thing, and acknowledges it by a file."""

    def acknowledge() -> None:
        (root / "acknowledged").open("ab").close()

    checkpoints.save(root / "checkpoints", checkpoints.Checkpoint(1, {"weights": torch.zeros(3)}, {"lr": 0.1}))
    acknowledge()
    jobs, store = JobStore(root / "fits", noun="fit"), ModelStore(root / "models")
    fit_id = jobs.create({"idempotency_key": ""}, {"steps": 1})
    acknowledge()
    jobs.record(fit_id, "running", step=1)
    acknowledge()
    write_atomic(root / "model" / "card.json", b"{}")  # as the child process of a fit does
    ref = store.publish("", root / "model")
    acknowledge()
    store.activate(ref)
    acknowledge()


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    if len(sys.argv) > 2:
        write_down_calls(sys.argv[2])
    save_all(folder)
