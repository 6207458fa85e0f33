"""Fits of the demo: started over REST, followed to their end. Fits of different services run side by side."""

import time
from collections.abc import Mapping
from contextlib import aclosing
from dataclasses import dataclass

from freerein.cli import job_events
from freerein.cli.demo.context import Context
from freerein.clients import FitClient
from freerein.errors import FailedPrecondition


@dataclass(frozen=True)
class RunningFit:
    """A fit that was started.

    Attributes:
        service: Who fits.
        id: Its id.
        steps: Updates that it will make.
        name: The model's name.
        begun: When it was asked for, by `time.perf_counter`.
    """

    service: str
    id: str
    steps: int
    name: str
    begun: float


async def start_fit(
    context: Context, service: str, dataset: str, *, model_name: str, config: Mapping[str, object]
) -> RunningFit:
    """Starts a fit; a service's fits wait for one another."""
    request = {"dataset": dataset, "model_name": model_name, "config": {**config, "seed": context.seed}}
    async with context.door(service) as door:
        begun = time.perf_counter()
        fit = (await door.post("/v1/start-fit", request))["fit"]
    return RunningFit(service, fit["id"], fit["steps"], model_name, begun)


async def follow_fit(context: Context, running: RunningFit) -> float:
    """Shows a fit's progress to its end; returns how long it took since it was asked for, in seconds.

    Raises:
        FailedPrecondition: It ended without a model.
        ServiceError: The service went away for good.
    """
    context.screen.call(f"freerein fit watch {running.id} --service {running.service}")
    with context.screen.progress(f"{running.service} {running.name}", running.steps) as advance:
        async with (
            FitClient(context.channel(running.service)) as client,
            aclosing(job_events.follow_fit(client, running.id)) as changes,
        ):
            async for fit in changes:
                advance(fit.step, " ".join(f"{name} {value:.3g}" for name, value in fit.metrics.items()))
    if fit.state != "succeeded":
        raise FailedPrecondition(
            f"The fit of {running.name} must succeed; its state is {fit.state}. {fit.error}".rstrip(),
            hint="Read log.txt in the fit's folder below the data directory.",
        )
    return time.perf_counter() - running.begun
