"""Runs arms in child processes, a few at a time.

    <work>/arms/<experiment>/<arm>-<hash>/   configuration, checkpoints and metrics of an arm; see `cache_paths`

An arm that was killed resumes from its newest checkpoint. The lock of its folder excludes a second runner.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from experiments.workbench import results
from experiments.workbench.arms import Arm, Experiment, is_current, world_version
from experiments.workbench.cache_paths import cache_path
from freerein.atomic_files import make_folder, write_atomic
from freerein.jobs.child import STOPPED, locked

_POLL_S = 0.1

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
    should_stop: Callable[[], bool],
    on_end: Callable[[Arm, Ending], None],
) -> list[Ending]:
    """Runs arms that have no result yet; returns how each ended, in order.

    A result made by another configuration or another version of the world is replaced.

    Args:
        name: Name of the experiment.
        experiment: The experiment.
        arms: Arms of it.
        places: Folders.
        jobs: Arms at a time.
        should_stop: Polled on any thread; when True, unfinished arms are stopped, and resume in the next run.
        on_end: Called as each arm ends, on any thread.
    """

    def run_one(arm: Arm) -> Ending:
        ending: Ending = "present"
        if not _has_result(name, experiment, arm, places):
            ending = _run_locked(name, experiment, arm, places, should_stop)
        on_end(arm, ending)
        return ending

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(run_one, arms))


def arm_folder(name: str, experiment: Experiment, arm: Arm, places: Places) -> Path:
    """Returns the folder of an arm's checkpoints; another configuration or another world has another folder."""
    made_by = {"config": experiment.config(arm), "world_version": world_version(arm.world)}
    return cache_path(places.work / "arms" / name, made_by, prefix=f"{arm.name}-")


def _has_result(name: str, experiment: Experiment, arm: Arm, places: Places) -> bool:
    path = places.results / name / f"{arm.name}.json"
    return path.is_file() and is_current(experiment, arm, results.load(path))


def _run_locked(name: str, experiment: Experiment, arm: Arm, places: Places, should_stop: Callable[[], bool]) -> Ending:
    """Starts or resumes the child process of an arm, unless another runner has finished it meanwhile."""
    folder = arm_folder(name, experiment, arm, places)
    make_folder(folder)
    with locked(folder, should_stop) as lock:
        if lock is None or should_stop():
            return "stopped"
        if _has_result(name, experiment, arm, places):
            return "present"
        job = {"experiment": name, "arm": arm.name, "results": str(places.results / name), "work": str(places.work)}
        write_atomic(folder / "config.json", json.dumps(job).encode())
        return _run_child(folder, lock, should_stop)


def _run_child(folder: Path, lock: int, should_stop: Callable[[], bool]) -> Ending:
    """Returns how the child process of an arm ended; it ends with this process."""
    with subprocess.Popen(
        [sys.executable, "-m", "freerein.program", "experiments.child", str(folder)],
        stdin=subprocess.PIPE,
        pass_fds=[lock],  # held until both are gone: a child that outlives us for a moment excludes the next
    ) as child:
        while child.poll() is None:
            if should_stop():
                child.terminate()
                return "stopped" if child.wait() else "finished"
            with suppress(subprocess.TimeoutExpired):
                child.wait(_POLL_S)
    if child.returncode == 0:
        return "finished"
    return "stopped" if child.returncode == STOPPED else "failed"
