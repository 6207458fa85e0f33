"""What every stage of the demo shares: service clients, dataset folders, the seed, and starting and following jobs."""

import json
import shlex
from collections.abc import Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from freerein.cli.commands.sim import record
from freerein.cli.connection import channel_to
from freerein.cli.demo.report import Reporter
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.progress import JobProgress
from freerein.cli.jobs.streams import follow_fit, follow_run
from freerein.cli.services import Endpoints
from freerein.cli.settings import CliSettings
from freerein.clients import Channel, FitClient, OrchestratorClient, SimClient
from freerein.data import dataset_path
from freerein.types.learning import Fit, StartFitRequest
from freerein.types.orchestrator import GetArtifactRequest, RunKind, StartRunRequest
from freerein.types.sim import DemonstrateRequest

HELD_OUT_SEED = 1_000_000
"""Added to the seed for held-out data and evaluation episodes."""


@dataclass(frozen=True, eq=False)
class Context:
    """Addresses, settings, data directory and seed of a demo; records datasets, and starts and follows jobs."""

    endpoints: Endpoints
    settings: CliSettings
    data_dir: Path
    seed: int
    reporter: Reporter

    def dataset(self, name: str) -> Path:
        """Returns the folder of a dataset."""
        return dataset_path(self.data_dir, name)

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
    ) -> tuple[str, Fit]:
        """Starts a fit, which `follow_fit` takes; each service runs one fit at a time."""
        seeded = {**config, "seed": self.seed}
        self.reporter.command(f"freerein fit {service} {dataset} --model-name {model_name} {_options(seeded)}")
        async with FitClient(self.channel(service)) as client:
            return service, (await client.start_fit(StartFitRequest(dataset, model_name, seeded))).fit

    async def follow_fit(self, started: tuple[str, Fit]) -> None:
        """Shows a fit's progress to its end; raises FailedPrecondition where it did not succeed."""
        service, fit = started
        self.reporter.command(f"freerein fit watch {fit.id} --service {service}")
        with self.reporter.progress(f"{service} {fit.model_name}", fit.steps) as advance:
            client = FitClient(self.channel(service))
            async with client, aclosing(follow_fit(client, fit.id)) as changes:
                async for fit in changes:
                    advance(fit.step, " ".join(f"{name} {value:.3g}" for name, value in fit.metrics.items()))
        check_succeeded(f"fit of {fit.model_name}", fit)

    async def start_run(self, kind: RunKind, config: dict[str, Any]) -> str:
        """Starts a run; returns its id. The orchestrator runs one run at a time."""
        self.reporter.command(f"freerein runs start {kind} {_options(config)}")
        async with OrchestratorClient(self.channel("orchestrator")) as client:
            return (await client.start_run(StartRunRequest(kind, config))).run.id

    async def follow_run(self, name: str, run_id: str, *, metrics: Sequence[str] = ()) -> JobProgress:
        """Shows a run's progress, with the curves of `metrics`, as `follow_fit`; returns all curves."""
        self.reporter.command(f"freerein runs watch {run_id}")
        client = OrchestratorClient(self.channel("orchestrator"))
        async with client, aclosing(follow_run(client, run_id)) as changes:
            with self.reporter.curves(name, metrics) as show:
                async for run in changes:
                    curves = show(run)
        check_succeeded(f"run {name}", run)
        return curves

    async def artifact(self, run_id: str, name: str) -> dict[str, Any]:
        """Returns a JSON artifact of a run."""
        self.reporter.command(f"freerein runs artifacts {run_id} {name} --out -")
        client = OrchestratorClient(self.channel("orchestrator"))
        async with client, aclosing(client.get_artifact(GetArtifactRequest(run_id, name))) as parts:
            document: dict[str, Any] = json.loads(b"".join([part.data async for part in parts]))
        return document


def _options(config: Mapping[str, object]) -> str:
    """Returns a configuration as `--set` options."""
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in config.items()}
    return " ".join(f"--set {shlex.quote(f'{key}={text}')}" for key, text in texts.items())


def _record_command(name: str, request: DemonstrateRequest) -> str:
    """Returns the command line that records the same demonstrations."""
    words = f"freerein sim demonstrate {request.task} --out {name} --count {request.count} --seed {request.seed}"
    if request.behaviour == "random":
        return f"{words} --behaviour random"
    skills = f"--min-skills {request.min_skills} --max-skills {request.max_skills}"
    return f"{words} {skills}" + " --truth" * request.privileged
