"""The orchestrator as a process: `python -m freerein_orchestrator`."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from freerein.api.orchestrator.v1 import orchestrator_pb2
from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.jobs.attempt import AttemptRunner
from freerein.jobs.in_use import check_unused, names_run
from freerein.jobs.names import LINKS
from freerein.jobs.store import JobStore
from freerein.learning.model_files import choose_device
from freerein.learning.optimiser import IMPORTED_BY_OPTIMISERS
from freerein.ports import PORTS, addresses, rest_url
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.web_page import WebPage
from freerein_orchestrator.datasets import DatasetService
from freerein_orchestrator.kinds import KINDS, find_kind
from freerein_orchestrator.kinds.config_schemas import run_config_schema
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.runs.dbos_queue import DbosQueue
from freerein_orchestrator.runs.service import Resolved, RunService
from freerein_orchestrator.settings import OrchestratorSettings
from freerein_orchestrator.web.calls import CALLS
from freerein_orchestrator.web.page import ASSETS, page_routes
from freerein_orchestrator.web.passing_on import PassedOn, make_client

NAME = "orchestrator"


def build(
    settings: OrchestratorSettings,
    limits: Limits,
    _metrics: Metrics,
    health: Health,
    *,
    start_child: StartChild = spawn,
) -> Service:
    """Returns the service.

    Raises:
        FailedPrecondition: This machine lacks the device of the settings, or the data directory cannot be made.
        InvalidInput: An address or URL of a service is malformed.
    """
    choose_device(settings.device)
    settings.make_data_dir()
    for service in PORTS:
        addresses(service, os.environ)
    folder = settings.data_dir / "runs"
    store = JobStore(folder, noun="run", links=settings.data_dir / LINKS)
    runner = AttemptRunner(
        store,
        module="freerein_orchestrator.runs",
        arguments=(str(settings.data_dir), settings.device),
        hidden_env=("FREEREIN_DATABASE_URL",),  # holds a password
        start_child=start_child,
    )
    queue = DbosQueue(
        folder,
        store=store,
        attempt=runner.run,
        database_url=settings.database_url.get_secret_value() if settings.database_url else "",
        executor_id=settings.executor_id,
    )
    resolve_here = partial(resolve, data_dir=settings.data_dir)
    policies, unused = PolicyStore.open(settings.data_dir, os.environ), partial(_check_unused, settings)
    truth_of = partial(truth, policies)
    runs = RunService(store, queue, resolve=resolve_here, health=health, truth=truth_of, check_unused=unused)
    datasets = DatasetService(settings.data_dir)
    client = make_client(limits, token=settings.token_text, certificate=os.environ.get("FREEREIN_TLS_CERT"))
    passed_on = [PassedOn(service, rest_url(service, os.environ), client) for service in CALLS]

    async def close() -> None:
        await runs.close()
        datasets.close()
        await client.aclose()

    return Service(
        name=NAME,
        methods=methods_of(orchestrator_pb2.DESCRIPTOR.services_by_name["OrchestratorService"], runs, datasets),
        start=runs.start,
        close=close,
        not_ready=runs.not_ready,
        jobs={"run": folder},
        configs=lambda: {"StartRunRequest": run_config_schema()},
        page=WebPage([*page_routes(), *(route for each in passed_on for route in each.routes)], assets=ASSETS),
    )


def _check_unused(settings: OrchestratorSettings, run_id: str) -> None:
    check_unused(settings.data_dir, f"Run {run_id[:8]}", names_run(run_id))


def resolve(kind: str, config: Mapping[str, Any], data_dir: Path) -> Resolved:
    """Returns the whole configuration of a run, and its number of steps.

    Raises:
        InvalidInput: The configuration is wrong, or builds on what does not exist.
    """
    chosen = find_kind(kind)
    parsed = chosen.parse(config)
    chosen.check(parsed, PolicyStore.open(data_dir, os.environ), {})
    return Resolved(chosen.dump(parsed), chosen.steps(parsed))


def truth(policies: PolicyStore, kind: str, config: Mapping[str, Any]) -> str:
    """Returns the privileged data that a run reads; empty for none, or for a kind that there is no longer."""
    return KINDS[kind].truth(config, policies) if kind in KINDS else ""


if __name__ == "__main__":
    fork_server = ForkServer.fork(IMPORTED_BY_OPTIMISERS)
    run(NAME, OrchestratorSettings, partial(build, start_child=fork_server.start))
