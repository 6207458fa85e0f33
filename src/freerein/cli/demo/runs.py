"""Runs of the demo: started over REST, followed to their end, and what they leave behind fetched over REST again."""

from collections.abc import Mapping, Sequence
from contextlib import aclosing
from typing import Any

from freerein.cli.demo.context import Context
from freerein.cli.job_events import follow_run
from freerein.cli.job_progress import JobProgress
from freerein.errors import FailedPrecondition
from freerein.types.orchestrator import RunKind


async def start_run(context: Context, kind: RunKind, config: Mapping[str, object]) -> str:
    """Starts a run; returns its id. Runs wait for one another."""
    async with context.door("orchestrator") as door:
        started = await door.post("/v1/start-run", {"kind": kind, "config": config})
    return str(started["run"]["id"])


async def finish_run(context: Context, name: str, run_id: str, *, metrics: Sequence[str] = ()) -> JobProgress:
    """Shows how a run goes on until it ends; returns the course that it took.

    Args:
        context: Where the demo runs.
        name: What the run is called on screen.
        run_id: Which.
        metrics: Whose curves are drawn.

    Raises:
        FailedPrecondition: It did not succeed.
    """
    context.screen.call(f"freerein runs watch {run_id}")
    async with context.orchestrator() as client, aclosing(follow_run(client, run_id)) as changes:
        with context.screen.course(name, metrics) as show:
            async for run in changes:
                course = show(run)
    if run.state != "succeeded":
        raise FailedPrecondition(
            f"The run {name} must succeed; its state is {run.state}. {run.error}".rstrip(),
            hint="Read log.txt in the run's folder below the data directory.",
        )
    return course


async def artifact(context: Context, run_id: str, name: str) -> dict[str, Any]:
    """Returns what a file of JSON says that a run has left behind."""
    async with context.door("orchestrator") as door:
        return await door.get("/v1/get-artifact", id=run_id, name=name)
