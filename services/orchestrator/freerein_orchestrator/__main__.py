"""The orchestrator as a process: `python -m freerein_orchestrator`."""

import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.types.orchestrator import RunKind
from freerein_orchestrator.durable import DurableRuns
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.runs.attempts import Attempts
from freerein_orchestrator.runs.core import Resolved, Runs
from freerein_orchestrator.runs.records import RunRecords
from freerein_orchestrator.settings import OrchestratorSettings

NAME = "orchestrator"


def build(settings: OrchestratorSettings, _limits: Limits, _metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    records = RunRecords(settings.data_dir / "runs")
    attempts = Attempts(
        records, module="freerein_orchestrator.child", arguments=(str(settings.data_dir), settings.device)
    )
    durable = DurableRuns(
        settings.data_dir / "runs",
        database_url=settings.database_url.get_secret_value() if settings.database_url else "",
        executor_id=settings.executor_id,
        attempt=attempts.make,
        note_end=lambda run_id, state, reason: records.note(run_id, state, reason=reason),
    )
    runs = Runs(records, durable, resolve=lambda kind, config: resolve(kind, config, settings.data_dir), health=health)
    return Service(
        name=NAME,
        methods=methods_of(orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"], runs),
        start=runs.start,
        close=runs.close,
        not_ready=runs.not_ready,
    )


def resolve(kind: RunKind, config: Mapping[str, Any], data_dir: Path) -> Resolved:
    """Returns the whole configuration of a run, and its number of steps.

    Raises:
        InvalidInput: The configuration is wrong, or builds on what does not exist.
    """
    chosen = KINDS[kind]
    parsed = chosen.parse(config)
    chosen.check(parsed, PolicyStore.open(data_dir, os.environ), ())
    return Resolved(chosen.dump(parsed), chosen.steps(parsed))


if __name__ == "__main__":
    code = run(NAME, OrchestratorSettings, build)
    sys.stdout.flush()
    os._exit(code)  # `sys.exit` would wait for threads of DBOS, which wait for as long as a database is away
