"""The process of a run: `python -m freerein_orchestrator.runs FOLDER DATA_DIR DEVICE`."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freerein import program
from freerein.jobs.attempt import CANCELLED_FILE
from freerein.jobs.child import run_child, stop_on_sigterm
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.rl.errors import Stopped


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Does the work of a run, or resumes it; returns the exit code."""

    def work(job: Mapping[str, Any]) -> bool:
        kind = KINDS[job["kind"]]
        with stop_on_sigterm() as stop:
            context = RunContext(
                folder=folder,
                key=folder.name,
                data_dir=data_dir,
                device=device,
                environ=os.environ,
                stop=stop,
                cancelled=(folder / CANCELLED_FILE).is_file,
            )
            try:
                with context.closing:
                    kind.run(context, kind.parse(job["config"]))
            except Stopped:
                return False
        return True

    return run_child(folder, work)


if __name__ == "__main__":
    program.end(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
