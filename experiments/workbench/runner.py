"""Runs arms in child processes, a few at a time.

    <work>/arms/<experiment>/<arm>-<hash>/   configuration, checkpoints and metrics of an arm

An arm that was killed resumes from its newest checkpoint.
"""

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from experiments.workbench import results
from experiments.workbench.arms import Arm, Experiment, is_current
from freerein.atomic_files import write_atomic
from freerein.jobs.child import STOPPED

Ending = Literal["present", "finished", "stopped", "failed"]


@dataclass(frozen=True)
class Places:
    """Where results are written, and where datasets and checkpoints are kept."""

    results: Path = Path("experiments/results")
    work: Path = Path("var/experiments")


def run_arms(
    name: str,
    experiment: Experiment,
    arms: Sequence[Arm],
    *,
    places: Places,
    jobs: int,
    minutes: float,
    on_end: Callable[[Arm, Ending], None],
) -> list[Ending]:
    """Runs arms that have no result yet; returns how each ended, in order.

    A result made by another configuration or another world is replaced.

    Args:
        name: Name of the experiment.
        experiment: The experiment.
        arms: Arms of it.
        places: Folders.
        jobs: Arms at a time.
        minutes: Time limit; then unfinished arms are stopped, and resume in the next run.
        on_end: Called as each arm ends, on any thread.
    """
    deadline = time.monotonic() + 60 * minutes

    def run_one(arm: Arm) -> Ending:
        ending: Ending = "present"
        if not _has_result(name, experiment, arm, places):
            ending = _run_child(name, experiment, arm, places, deadline=deadline)
        on_end(arm, ending)
        return ending

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(run_one, arms))


def arm_folder(name: str, experiment: Experiment, arm: Arm, places: Places) -> Path:
    """Returns the folder of an arm's checkpoints; another configuration or another world has another folder."""
    config = json.dumps(experiment.config(arm), sort_keys=True) + experiment.world_hash(arm.world)
    return places.work / "arms" / name / f"{arm.name}-{hashlib.sha256(config.encode()).hexdigest()[:12]}"


def _has_result(name: str, experiment: Experiment, arm: Arm, places: Places) -> bool:
    path = places.results / name / f"{arm.name}.json"
    return path.is_file() and is_current(experiment, arm, results.load(path))


def _run_child(name: str, experiment: Experiment, arm: Arm, places: Places, *, deadline: float) -> Ending:
    """Starts or resumes the child process of an arm; it ends with this process."""
    if time.monotonic() >= deadline:
        return "stopped"
    folder = arm_folder(name, experiment, arm, places)
    job = {"experiment": name, "arm": arm.name, "results": str(places.results / name), "work": str(places.work)}
    write_atomic(folder / "config.json", json.dumps(job).encode())
    command = [sys.executable, "-m", "experiments.child", str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as child:
        try:
            code = child.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            child.terminate()
            code = STOPPED if child.wait() else 0
    if code == 0:
        return "finished"
    return "stopped" if code == STOPPED else "failed"
