"""The child process of an arm: `python -m experiments.child FOLDER`.

FOLDER holds `config.json`: names of experiment and arm, folders of results and datasets. Checkpoints are written to
FOLDER, the result to the folder of results. Exit codes are those of `freerein.jobs.child`.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from experiments import registry
from experiments.workbench import results
from experiments.workbench.arms import Arm, Experiment, choose, world_version
from experiments.workbench.configs import to_json
from experiments.workbench.elapsed import Elapsed
from experiments.workbench.results import ArmResult, Outcome
from freerein import program
from freerein.jobs.child import run_child


def main(folder: Path) -> int:
    """Runs or resumes an arm; returns the process's exit code."""

    def work(job: Mapping[str, Any]) -> bool:
        experiment = registry.load(job["experiment"])
        (arm,) = choose(experiment, [job["arm"]])
        if not experiment.prepare(arm, Path(job["work"])):
            return False
        elapsed = Elapsed(folder / "elapsed.json")
        outcome = experiment.run(
            arm, results=Path(job["results"]), work=Path(job["work"]), folder=folder, on_progress=elapsed.save
        )
        elapsed.save()
        if outcome is None:
            return False
        command = f"python -m experiments run {job['experiment']} --only {arm.name}"
        results.save(_result(experiment, arm, outcome, elapsed, command), Path(job["results"]))
        return True

    return run_child(folder, work)


def _result(experiment: Experiment, arm: Arm, outcome: Outcome, elapsed: Elapsed, command: str) -> ArmResult:
    return ArmResult(
        name=arm.name,
        world=arm.world,
        method=arm.method,
        options=arm.options,
        seed=arm.seed,
        config=to_json(experiment.config(arm)),
        world_version=world_version(arm.world),
        figures=outcome.figures,
        samples=outcome.samples,
        minutes=round(elapsed.minutes, 3),
        cpu_minutes=round(elapsed.cpu_minutes, 3),
        machine=results.machine(),
        command=command,
        shown=outcome.shown,
    )


if __name__ == "__main__":
    program.end(main(Path(sys.argv[1])))
