"""The process of a run: `python -m freerein_orchestrator.runs.child FOLDER DATA_DIR DEVICE`."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freerein.jobs.attempt import CANCELLED_FILE
from freerein.jobs.child import run_child, stop_on_sigterm
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.work import Work


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Does the work of a run, or resumes it; returns the exit code."""

    def work(asked: Mapping[str, Any]) -> bool:
        with stop_on_sigterm() as stop:
            run = Work(
                folder=folder,
                key=folder.name,
                config=asked["config"],
                data_dir=data_dir,
                device=device,
                environ=os.environ,
                stop=stop,
                cancelled=(folder / CANCELLED_FILE).is_file,
            )
            with run.closing:
                return KINDS[asked["kind"]].run(run)

    return run_child(folder, work)


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
