"""Recording the scripted behaviours of the sim service, `expert` and `random`."""

import time
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

from freerein.clients import SyncClient
from freerein.data import Dataset
from freerein.data.dataset_recorder import DatasetRecorder
from freerein.errors import ServiceError
from freerein.types.sim import Behaviour, DemonstrateRequest, DemonstrateResponse, ListTasksRequest
from freerein_orchestrator.envs.retry import Retry, is_transient
from freerein_orchestrator.kinds.collect.config import CollectConfig
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.metrics_logger import MetricsLogger

_ROW_S = 0.5


def demonstrate(context: RunContext, config: CollectConfig, behaviour: Behaviour, root: Path) -> None:
    """Records a scripted behaviour: each trajectory depends on the seed and its number alone.

    Args:
        context: The run's.
        config: Its configuration.
        behaviour: The behaviour.
        root: The dataset's folder.

    Raises:
        Stopped: The run is to stop.
        ServiceError: The sim service refuses, or the dataset holds something else.
    """
    sim, retry = context.client("sim"), context.retry()
    tasks = retry.call(lambda: sim.list_tasks(ListTasksRequest()))
    with DatasetRecorder(root, _request(config, behaviour), tasks) as recording:
        timesteps = int(Dataset(root).lengths.sum()) if len(recording) else 0
        rows = _ThrottledRows(context.metrics_logger(min(len(recording), config.count - 1)))
        with closing(_missing(sim, recording, retry)) as demonstrations:
            for demonstration in demonstrations:
                recording.append(demonstration)
                timesteps += len(demonstration.trajectory.actions)
                if not recording.is_complete:
                    rows.append(len(recording), timesteps)
                retry.interrupt()
        rows.write(len(recording), timesteps)


def _missing(sim: SyncClient, recording: DatasetRecorder, retry: Retry) -> Generator[DemonstrateResponse]:
    """Yields the demonstrations that a recording lacks, however often the sim service is unavailable."""
    while not recording.is_complete:
        try:
            with closing(sim.demonstrate(recording.remaining)) as demonstrations:
                for demonstration in demonstrations:
                    retry.reset()
                    yield demonstration
            recording.check_complete()
        except ServiceError as error:
            if not is_transient(error):
                raise
            retry.wait(error)


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
        conditions=config.conditions,
        settle=config.settle,
    )


class _ThrottledRows:
    """Writes at most two rows of metrics a second."""

    def __init__(self, logger: MetricsLogger) -> None:
        self._logger = logger
        self._next_s = time.monotonic()

    def append(self, trajectories: int, timesteps: int) -> None:
        """Writes a row unless one was written just now."""
        if time.monotonic() >= self._next_s:
            self.write(trajectories, timesteps)
            self._next_s = time.monotonic() + _ROW_S

    def write(self, trajectories: int, timesteps: int) -> None:
        """Writes a row."""
        self._logger.append(trajectories, {"timesteps": timesteps})
