"""The orchestrator in the contract: the real core, with one run that was cancelled and left a file behind."""

import time
from collections.abc import Callable
from pathlib import Path

from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.atomic_files import write_atomic
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.methods import methods_of
from freerein.types import orchestrator
from freerein.types.orchestrator import CancelRunRequest, StartRunRequest
from freerein_orchestrator.__main__ import resolve
from freerein_orchestrator.durable import DurableRuns
from freerein_orchestrator.outcomes import Attempt, Interrupted, Reason
from freerein_orchestrator.runs.core import Runs
from freerein_orchestrator.runs.records import RunRecords

CONFIG = {"task": "grid", "dataset": "demos", "behaviour": "random", "count": 3}
RUN = "33aff6d631d05c00849156bc87785527"


def build(data_dir: Path, health: Health) -> Service:
    records = RunRecords(data_dir / "runs")
    durable = DurableRuns(
        data_dir / "runs",
        executor_id="worker",
        attempt=wait,
        note_end=lambda run_id, state, reason: records.note(run_id, state, reason=reason),
    )
    runs = Runs(records, durable, resolve=lambda kind, config: resolve(kind, config, data_dir), health=health)

    async def start() -> None:
        await runs.start()
        run = (await runs.start_run(StartRunRequest("collect", CONFIG, "key"))).run
        assert run.id == RUN, run.id
        await runs.cancel_run(CancelRunRequest(run.id))
        write_atomic(records.folder(run.id) / "artifacts" / "policy.json", b"{}\n")

    contract = orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"]
    return Service("orchestrator", methods_of(contract, runs), start, runs.close, runs.not_ready)


def wait(_run_id: str, stop: Callable[[], Reason]) -> Attempt:
    while not stop():
        time.sleep(0.01)
    raise Interrupted


CASES = (
    ("StartRun", StartRunRequest("collect", CONFIG, "key")),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 4}, "key"), "already_exists"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "colour": "red"}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 0}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", {**CONFIG, "count": 2.5}), "invalid_input"),
    ("StartRun", StartRunRequest("collect", CONFIG, "../key"), "invalid_input"),
    ("GetRun", orchestrator.GetRunRequest(RUN)),
    ("GetRun", orchestrator.GetRunRequest("1" * 32), "not_found"),
    ("GetRun", orchestrator.GetRunRequest("../x"), "invalid_input"),
    ("ListRuns", orchestrator.ListRunsRequest()),
    ("WatchRun", orchestrator.WatchRunRequest(RUN)),
    ("WatchRun", orchestrator.WatchRunRequest(RUN, 1)),
    ("WatchRun", orchestrator.WatchRunRequest("1" * 32), "not_found"),
    ("WatchRun", orchestrator.WatchRunRequest("x", 3), "invalid_input"),
    ("CancelRun", orchestrator.CancelRunRequest(RUN)),
    ("CancelRun", orchestrator.CancelRunRequest("1" * 32), "not_found"),
    ("ResumeRun", orchestrator.ResumeRunRequest("1" * 32), "not_found"),
    ("ListArtifacts", orchestrator.ListArtifactsRequest(RUN)),
    ("ListArtifacts", orchestrator.ListArtifactsRequest("1" * 32), "not_found"),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "policy.json")),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "other.json"), "not_found"),
    ("GetArtifact", orchestrator.GetArtifactRequest(RUN, "../config.json"), "invalid_input"),
    ("GetArtifact", orchestrator.GetArtifactRequest("1" * 32, "policy.json"), "not_found"),
)
