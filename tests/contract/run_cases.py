"""The orchestrator in the contract: the real cores, with one run that was cancelled and left a file behind."""

import math
import time
from collections.abc import Callable
from pathlib import Path

from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.atomic_files import write_atomic
from freerein.jobs.attempt import AttemptStopped, StopRequest
from freerein.jobs.metrics import MetricsWriter
from freerein.jobs.retry import AttemptResult, Pause
from freerein.jobs.store import JobStore
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.methods import methods_of
from freerein.types import orchestrator
from freerein.types.orchestrator import CancelRunRequest, StartRunRequest
from freerein_orchestrator.__main__ import resolve
from freerein_orchestrator.datasets import DatasetService
from freerein_orchestrator.runs.dbos_queue import DbosQueue
from freerein_orchestrator.runs.service import RunService

CONFIG = {"task": "grid", "dataset": "demos", "behaviour": "random", "count": 3}
RUN = "33aff6d631d05c00849156bc87785527"


def build(data_dir: Path, health: Health) -> Service:
    store = JobStore(data_dir / "runs", noun="run")
    queue = DbosQueue(data_dir / "runs", store=store, executor_id="worker", attempt=wait)
    runs = RunService(store, queue, resolve=lambda kind, config: resolve(kind, config, data_dir), health=health)

    async def start() -> None:
        await runs.start()
        run = (await runs.start_run(StartRunRequest("collect", CONFIG, "key"))).run
        assert run.id == RUN, run.id
        await runs.cancel_run(CancelRunRequest(run.id))
        write_atomic(store.folder(run.id) / "artifacts" / "policy.json", b"{}\n")
        writer = MetricsWriter(store.folder(run.id) / "metrics.jsonl", last_step=0)
        for step in (1, 2, 3):
            writer.append(step, {"loss": 1 / step, "broken": math.nan})

    contract = orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"]
    methods = methods_of(contract, runs, DatasetService(data_dir))
    return Service("orchestrator", methods, start, runs.close, runs.not_ready)


def wait(_run_id: str, stop: Callable[[], StopRequest], _pause: Pause) -> AttemptResult:
    while not stop():
        time.sleep(0.01)
    raise AttemptStopped


CASES = (
    ("StartRun", StartRunRequest("collect", CONFIG, "key")),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 4}, "key"), "already_exists"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "colour": "red"}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 0}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 2.5}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", CONFIG, "../key"), "invalid_input"),
    ("StartRun", StartRunRequest("PPo", CONFIG), "invalid_input"),
    ("GetRun", orchestrator.GetRunRequest(RUN)),
    ("GetRun", orchestrator.GetRunRequest("1" * 32), "not_found"),
    ("GetRun", orchestrator.GetRunRequest("../x"), "invalid_input"),
    ("ListRuns", orchestrator.ListRunsRequest()),
    ("ListRuns", orchestrator.ListRunsRequest(1, f"1-{RUN}")),
    ("ListRuns", orchestrator.ListRunsRequest(1001), "invalid_input"),
    ("ListRuns", orchestrator.ListRunsRequest(0, "1" * 32), "invalid_input"),
    ("GetMetrics", orchestrator.GetMetricsRequest(RUN)),
    ("GetMetrics", orchestrator.GetMetricsRequest(RUN, 2, 1)),
    ("GetMetrics", orchestrator.GetMetricsRequest("1" * 32), "not_found"),
    ("GetMetrics", orchestrator.GetMetricsRequest("../x"), "invalid_input"),
    ("GetMetrics", orchestrator.GetMetricsRequest(RUN, 0, 10_001), "invalid_input"),
    ("WatchRun", orchestrator.WatchRunRequest(RUN)),
    ("WatchRun", orchestrator.WatchRunRequest(RUN, 1)),
    ("WatchRun", orchestrator.WatchRunRequest("1" * 32), "not_found"),
    ("WatchRun", orchestrator.WatchRunRequest("x", 3), "invalid_input"),
    ("CancelRun", orchestrator.CancelRunRequest(RUN)),
    ("CancelRun", orchestrator.CancelRunRequest("1" * 32), "not_found"),
    ("ResumeRun", orchestrator.ResumeRunRequest("1" * 32), "not_found"),
    ("DeleteRun", orchestrator.DeleteRunRequest("1" * 32), "not_found"),
    ("DeleteRun", orchestrator.DeleteRunRequest("../x"), "invalid_input"),
    ("ListArtifacts", orchestrator.ListArtifactsRequest(RUN)),
    ("ListArtifacts", orchestrator.ListArtifactsRequest("1" * 32), "not_found"),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "policy.json")),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "other.json"), "not_found"),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "../config.json"), "invalid_input"),
    ("GetArtifact", orchestrator.GetArtifactRequest("1" * 32, "policy.json"), "not_found"),
)
