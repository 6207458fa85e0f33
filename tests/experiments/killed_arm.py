"""An arm of the smoke experiment that kills its process in the middle of training: FOLDER WORK ARM."""

import itertools
import os
import signal
import sys
from pathlib import Path

from experiments import registry
from experiments.workbench.arms import choose

EVENTS = 3  # checkpoints every second step, and evaluations every fourth; 12 steps are due


def main(folder: Path, work: Path, name: str) -> None:
    experiment = registry.load("smoke")
    (arm,) = choose(experiment, [name])
    events = itertools.count(1)

    def kill_in_the_middle() -> None:
        if next(events) == EVENTS:
            os.kill(os.getpid(), signal.SIGKILL)

    experiment.run(arm, results=work / "results", work=work, folder=folder, on_progress=kill_in_the_middle)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
