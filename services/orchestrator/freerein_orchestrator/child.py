"""A run as a process of its own: `python -m freerein_orchestrator.child FOLDER DATA_DIR DEVICE`.

FOLDER holds `config.json`. The exit code is 0 for a run that is done, 1 for one that was stopped and can go on, 2 for
one that cannot succeed, for the reason on stderr's last line.
"""

import json
import os
import sys
from pathlib import Path

from freerein.serving.child import end_with_parent
from freerein.serving.fit_child import STOPPED

from freerein.errors import ServiceError
from freerein.learning.fit import stop_on_sigterm
from freerein.serving.fits import HOPELESS
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.outcomes import CANCELLED
from freerein_orchestrator.work import Work


def main(folder: Path, data_dir: Path, device: str) -> int:
    """Does the work of a run, or goes on with it; returns the process's exit code."""
    end_with_parent()
    asked = json.loads((folder / "config.json").read_bytes())
    with stop_on_sigterm() as stop:
        work = Work(
            folder=folder,
            key=folder.name,
            config=asked["config"],
            data_dir=data_dir,
            device=device,
            environ=os.environ,
            stop=stop,
            cancelled=(folder / CANCELLED).is_file,
        )
        try:
            with work.closing:
                return 0 if KINDS[asked["kind"]].run(work) else STOPPED
        except ServiceError as error:
            work.say(f"{error.detail} {error.hint}")
            return HOPELESS


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
