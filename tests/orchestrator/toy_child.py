"""A run's child process that counts: arguments FOLDER WORKER. It waits where it is told to, once, to be killed."""

import json
import os
import signal
import sys
from pathlib import Path

from freerein.atomic_files import write_atomic
from freerein.jobs.child import STOPPED, die_with_parent


def main(folder: Path, worker: str) -> int:
    die_with_parent()
    config = json.loads((folder / "config.json").read_bytes())["config"]
    signal.signal(signal.SIGTERM, signal.SIG_IGN if config.get("deaf") else lambda *_: sys.exit(save(folder)))
    (folder / "worker.txt").write_text(worker)
    with (folder / "pids.txt").open("a") as pids:
        pids.write(f"{os.getpid()}\n")
    if len((folder / "pids.txt").read_text().split()) <= config.get("killed", 0):
        signal.pause()
    checkpoint = folder / "checkpoint.txt"
    step = int(checkpoint.read_text()) if checkpoint.exists() else 0
    if config.get("complaint"):
        sys.stderr.write(config["complaint"] + "\n")
        return 2
    while step < config["steps"]:
        step += 1
        write_atomic(checkpoint, b"%d" % step)
        with (folder / "steps.txt").open("a") as steps:
            steps.write(f"{step}\n")
        with (folder / "metrics.jsonl").open("a") as metrics:
            metrics.write(json.dumps({"step": step, "loss": 1 / step, "broken": float("nan")}) + "\n")
        if step == config.get("wait_at"):
            signal.pause()
    if config.get("crash"):
        os.abort()
    write_atomic(folder / "artifacts" / "count.txt", b"%d" % step)
    return 0


def save(folder: Path) -> int:
    write_atomic(folder / "saved.txt", b"yes")
    return STOPPED


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), sys.argv[2]))
