"""What every stage of the demo shares: service clients, dataset folders, the seed, and starting and following jobs."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager, aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freerein.cli import job_events
from freerein.cli.connection import channel_to
from freerein.cli.demo.report import Reporter
from freerein.cli.demo.rest_client import RestClient
from freerein.cli.job_progress import JobProgress
from freerein.cli.recording import record
from freerein.cli.services import Endpoints
from freerein.cli.settings import CliSettings
from freerein.clients import Channel, FitClient, OrchestratorClient, SimClient
from freerein.data import dataset_path
from freerein.errors import FailedPrecondition
from freerein.types.orchestrator import RunKind
from freerein.types.sim import DemonstrateRequest

HELD_OUT_SEED = 1_000_000
"""Added to the seed for held-out data and evaluation episodes."""


@dataclass(frozen=True)
class RunningFit:
    """A fit that was started.

    Attributes:
        service: Name of the service that fits.
        id: Id of the fit.
        steps: Planned updates.
        model_name: Name of the model.
    """

    service: str
    id: str
    steps: int
    model_name: str


@dataclass(frozen=True, eq=False)
class Context:
    """Where and how the demo runs.

    Attributes:
        endpoints: Addresses of the services.
        settings: Token and certificate of the services.
        data_dir: The services' data directory.
        out: Output folder.
        seed: Random seed.
        reporter: Prints progress.
    """

    endpoints: Endpoints
    settings: CliSettings
    data_dir: Path
    out: Path
    seed: int
    reporter: Reporter

    def dataset(self, name: str) -> Path:
        """Returns the folder of a dataset."""
        return dataset_path(self.data_dir, name)

    def rest(self, service: str) -> AbstractAsyncContextManager[RestClient]:
        """Returns a REST client of a service."""
        url = self.endpoints.urls[service]
        return RestClient(url, self.settings, requests=self.out / "requests", reporter=self.reporter)

    def channel(self, service: str) -> Channel:
        """Returns a gRPC channel to a service."""
        return channel_to(self.endpoints.addresses[service], self.settings)

    def sim(self) -> SimClient:
        """Returns a client of the sim service."""
        return SimClient(self.channel("sim"))

    async def record(self, name: str, request: DemonstrateRequest) -> None:
        """Records demonstrations into a dataset."""
        self.reporter.command(_record_command(name, request))
        with self.reporter.progress(name, request.count) as advance:
            async with self.sim() as client:
                await record(client, request, self.dataset(name), on_count=advance)

    async def start_fit(
        self, service: str, dataset: str, *, model_name: str, config: Mapping[str, object]
    ) -> RunningFit:
        """Starts a fit; each service runs one fit at a time."""
        request = {"dataset": dataset, "model_name": model_name, "config": {**config, "seed": self.seed}}
        async with self.rest(service) as client:
            fit = (await client.post("/v1/start-fit", request))["fit"]
        return RunningFit(service, fit["id"], fit["steps"], model_name)

    async def follow_fit(self, running: RunningFit) -> None:
        """Shows a fit's progress to its end.

        Raises:
            FailedPrecondition: It ended without a model.
            ServiceError: The service is gone.
        """
        self.reporter.command(f"freerein fit watch {running.id} --service {running.service}")
        with self.reporter.progress(f"{running.service} {running.model_name}", running.steps) as advance:
            async with (
                FitClient(self.channel(running.service)) as client,
                aclosing(job_events.follow_fit(client, running.id)) as changes,
            ):
                async for fit in changes:
                    advance(fit.step, " ".join(f"{name} {value:.3g}" for name, value in fit.metrics.items()))
        _check_succeeded(f"fit of {running.model_name}", fit.state, fit.error)

    async def start_run(self, kind: RunKind, config: Mapping[str, object]) -> str:
        """Starts a run; returns its id. The orchestrator runs one run at a time."""
        async with self.rest("orchestrator") as client:
            started = await client.post("/v1/start-run", {"kind": kind, "config": config})
        return str(started["run"]["id"])

    async def follow_run(self, name: str, run_id: str, *, metrics: Sequence[str] = ()) -> JobProgress:
        """Shows a run's progress to its end; returns its curves.

        Args:
            name: Name on the terminal.
            run_id: Id of the run.
            metrics: Metrics whose curves are drawn.

        Raises:
            FailedPrecondition: It did not succeed.
        """
        self.reporter.command(f"freerein runs watch {run_id}")
        async with (
            OrchestratorClient(self.channel("orchestrator")) as client,
            aclosing(job_events.follow_run(client, run_id)) as changes,
        ):
            with self.reporter.curves(name, metrics) as show:
                async for run in changes:
                    curves = show(run)
        _check_succeeded(f"run {name}", run.state, run.error)
        return curves

    async def artifact(self, run_id: str, name: str) -> dict[str, Any]:
        """Returns a JSON artifact of a run."""
        async with self.rest("orchestrator") as client:
            return await client.get("/v1/get-artifact", id=run_id, name=name)


def _check_succeeded(name: str, state: str, error: str) -> None:
    if state != "succeeded":
        raise FailedPrecondition(
            f"The {name} must succeed; its state is {state}. {error}".rstrip(),
            hint="Read log.txt in its folder in the data directory.",
        )


def _record_command(name: str, request: DemonstrateRequest) -> str:
    """Returns the command line that records the same demonstrations."""
    words = f"freerein sim demonstrate {request.task} --out {name} --count {request.count} --seed {request.seed}"
    if request.behaviour == "random":
        return f"{words} --behaviour random"
    skills = f"--min-skills {request.min_skills} --max-skills {request.max_skills}"
    return f"{words} {skills}" + " --truth" * request.privileged
