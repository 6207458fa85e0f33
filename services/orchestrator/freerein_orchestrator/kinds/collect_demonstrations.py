"""Records the scripted behaviours of the sim service, `expert` and `random`, through its stream of demonstrations."""

import time
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

import numpy as np

from freerein.clients import SyncClient
from freerein.clients.dataset_recorder import DatasetRecorder
from freerein.data import Dataset
from freerein.types.sim import Behaviour, DemonstrateRequest, DemonstrateResponse, ListTasksRequest
from freerein_orchestrator.curve import Curve
from freerein_orchestrator.kinds.collect_config import CollectConfig
from freerein_orchestrator.patience import AWAY, Patience
from freerein_orchestrator.work import Work

_ROW_S = 0.5


def demonstrate(work: Work, config: CollectConfig, behaviour: Behaviour, root: Path) -> None:
    """Records what a scripted behaviour does: each trajectory follows from the seed and its number alone.

    Args:
        work: The run.
        config: What was chosen.
        behaviour: Who acts.
        root: Where the dataset lies, or will lie.

    Raises:
        Stopped: The run is to stop.
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    sim = work.client("sim")
    patience = Patience(np.random.default_rng(), stop=work.stop, say=work.say)
    tasks = patience.ask(lambda: sim.list_tasks(ListTasksRequest()))
    with DatasetRecorder(root, _request(config, behaviour), tasks) as recording:
        timesteps = int(Dataset(root).lengths.sum())
        rows = _Rows(work.curve(last_step=min(len(recording), config.count - 1)))
        with closing(_missing(sim, recording, patience)) as demonstrations:
            for demonstration in demonstrations:
                recording.append(demonstration)
                timesteps += len(demonstration.trajectory.actions)
                if not recording.is_complete:
                    rows.append(len(recording), timesteps)
                patience.interrupt()
        rows.finish(len(recording), timesteps)


def _missing(sim: SyncClient, recording: DatasetRecorder, patience: Patience) -> Generator[DemonstrateResponse]:
    """Yields the demonstrations that a recording lacks, however often the sim service goes away."""
    while not recording.is_complete:
        try:
            with closing(sim.demonstrate(recording.remaining)) as demonstrations:
                for demonstration in demonstrations:
                    patience.answered()
                    yield demonstration
            recording.check_complete()
        except AWAY as error:
            patience.wait(error)


def _request(config: CollectConfig, behaviour: Behaviour) -> DemonstrateRequest:
    return DemonstrateRequest(
        task=config.task,
        behaviour=behaviour,
        skills=config.skills,
        min_skills=config.min_skills,
        max_skills=config.max_skills,
        count=config.count,
        seed=config.seed,
        cameras=config.cameras,
        height=config.height,
        width=config.width,
    )


class _Rows:
    """Rows of a run's curve, but no more than two a second."""

    def __init__(self, curve: Curve) -> None:
        self._curve = curve
        self._next_s = time.monotonic()

    def append(self, trajectories: int, timesteps: int) -> None:
        """Adds a row unless there has just been one."""
        if time.monotonic() >= self._next_s:
            self.finish(trajectories, timesteps)
            self._next_s = time.monotonic() + _ROW_S

    def finish(self, trajectories: int, timesteps: int) -> None:
        """Adds a row."""
        self._curve.append(trajectories, {"timesteps": timesteps})
