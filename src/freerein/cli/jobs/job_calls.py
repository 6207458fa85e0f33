"""The RPCs about fits and runs, whose names and messages differ in the noun alone."""

from collections.abc import AsyncGenerator, Mapping, Sequence
from typing import Any, Literal, TypeAlias

from freerein.cli.jobs.progress import Job
from freerein.cli.jobs.streams import follow_fit, follow_run
from freerein.clients import FitClient, OrchestratorClient
from freerein.types import learning, orchestrator
from freerein.types.jobs import MetricRow
from freerein.types.learning import GetFitMetricsRequest
from freerein.types.orchestrator import GetMetricsRequest

JobClient: TypeAlias = FitClient | OrchestratorClient

CLIENTS: Mapping[str, type[JobClient]] = {
    **dict.fromkeys(("segmentation", "imitation", "reward"), FitClient),
    "orchestrator": OrchestratorClient,
}
"""The client of the jobs of each service that has some."""


def noun_of(service: str) -> Literal["fit", "run"]:
    """Returns what a service calls its jobs."""
    return "run" if service == "orchestrator" else "fit"


async def ask(client: JobClient, verb: Literal["get", "cancel", "resume", "delete"], job_id: str) -> Any:
    """Asks to get, cancel, resume or delete a job; returns it as it is then, unless it is deleted."""
    noun, messages = _names(client)
    request = getattr(messages, f"{verb.capitalize()}{noun.capitalize()}Request")(job_id)
    return getattr(await getattr(client, f"{verb}_{noun}")(request), noun, None)


async def all_jobs(client: JobClient) -> list[Job]:
    """Returns all jobs of a service, newest first."""
    noun, messages = _names(client)
    request, list_page = getattr(messages, f"List{noun.capitalize()}sRequest"), getattr(client, f"list_{noun}s")
    page = await list_page(request())
    jobs = list[Job](getattr(page, f"{noun}s"))
    while page.next_page_token:
        page = await list_page(request(page_token=page.next_page_token))
        jobs += getattr(page, f"{noun}s")
    return jobs


async def metric_rows(client: JobClient, job_id: str, from_step: int = 0, max_rows: int = 0) -> Sequence[MetricRow]:
    """Returns the metrics of a job from a step on, decimated to `max_rows`; 0 for the service's own bound."""
    if isinstance(client, FitClient):
        return (await client.get_fit_metrics(GetFitMetricsRequest(job_id, from_step, max_rows))).rows
    return (await client.get_metrics(GetMetricsRequest(job_id, from_step, max_rows))).rows


def follow(client: JobClient, job_id: str) -> AsyncGenerator[Job, None]:
    """Yields a job after each change, from the first to the last."""
    return follow_fit(client, job_id) if isinstance(client, FitClient) else follow_run(client, job_id)


def _names(client: JobClient) -> tuple[str, Any]:
    """Returns what RPCs call a job, and the module of their messages."""
    return ("fit", learning) if isinstance(client, FitClient) else ("run", orchestrator)
