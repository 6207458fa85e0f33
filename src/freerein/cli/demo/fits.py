"""Fits of the demo: started over REST, followed by their events. Fits of different services run side by side."""

import time
from collections.abc import Mapping
from contextlib import aclosing
from dataclasses import dataclass

from freerein.cli.demo.context import Context
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
    """
    fit = {"state": "lost", "error": ""}
    async with context.door(running.service) as door:
        with context.screen.progress(f"{running.service} {running.name}", running.steps) as advance:
            async with aclosing(door.events("/v1/watch-fit", id=running.id)) as events:
                async for event in events:
                    fit = event["fit"]
                    advance(fit["step"], " ".join(f"{name} {value:.3g}" for name, value in fit["metrics"].items()))
    if fit["state"] != "succeeded":
        raise FailedPrecondition(
            f"The fit of {running.name} must succeed; it {fit['state']}. {fit['error']}",
            hint="Read log.txt in the fit's folder below the data directory.",
        )
    return time.perf_counter() - running.begun
