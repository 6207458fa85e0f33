"""Shared by the parts of the demo: the services' clients, the output folder, and runs of the orchestrator."""

import json
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from freerein.cli.demo.evaluations import Evaluation
from freerein.cli.demo.report import Figure, Reporter
from freerein.cli.demo.run_progress import RunProgress
from freerein.cli.jobs.display import check_succeeded
from freerein.cli.jobs.streams import follow_run
from freerein.clients import ImitationClient, OrchestratorClient, RewardClient, SegmentationClient, SimClient
from freerein.types.orchestrator import GetArtifactRequest, ListArtifactsRequest, Run, StartRunRequest

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

HELD_OUT_SEED = 1_000_000
"""Added to the seed for evaluations."""

PREFIX = "demo-"
"""Prefix of names of datasets and models, which may be stored beside a user's own and those that come with freerein."""


@dataclass(frozen=True)
class Clients:
    """A client of each service."""

    sim: SimClient
    segmentation: SegmentationClient
    imitation: ImitationClient
    reward: RewardClient
    orchestrator: OrchestratorClient


@dataclass(frozen=True)
class Demo:
    """Where a demo runs.

    Attributes:
        out: Output folder.
        data_dir: Data directory of the services.
        seed: Random seed.
        clients: The services.
        reporter: Shows what happens.
    """

    out: Path
    data_dir: Path
    seed: int
    clients: Clients
    reporter: Reporter

    async def run(
        self, name: str, kind: str, config: Mapping[str, Any], *, about_s: float, curve: str = "", unit: str = ""
    ) -> "FinishedRun":
        """Runs a run to its end, with its progress, and returns it; `curve` is the metric that is drawn.

        Raises FailedPrecondition when it did not succeed.
        """
        path = self.out / f"{name}.json"
        path.write_text(json.dumps(config, indent=2) + "\n")
        self.reporter.command(f"freerein run {kind} --config {path} --watch")
        client = self.clients.orchestrator
        progress = RunProgress(kind, about_s=about_s, started_s=time.monotonic(), curve=curve, unit=unit)
        async with self.reporter.following(progress):
            run = (await client.start_run(StartRunRequest(kind, dict(config)))).run
            async with aclosing(follow_run(client, run.id)) as changes:
                async for changed in changes:
                    run = changed
                    progress.add(run, at_s=time.monotonic())
        check_succeeded(f"{kind} run", run)
        return FinishedRun(run, progress.points)

    async def evaluate(self, name: str, form: str, *, about_s: float, **config: Any) -> Evaluation:
        """Runs an evaluation on data that nothing was fitted to."""
        seed = self.seed + HELD_OUT_SEED
        finished = await self.run(name, "evaluate", {"form": form, "seed": seed, **config}, about_s=about_s)
        return Evaluation.read(await artifacts(self.clients.orchestrator, finished.run.id))

    def save(self, picture: "Picture", name: str) -> None:
        """Writes a picture, and tells where."""
        path = self.out / f"{name}.png"
        picture.savefig(path)
        self.reporter.picture(path)


@dataclass(frozen=True)
class FinishedRun:
    """A run that succeeded, and the steps and values of its curve."""

    run: Run
    curve: Sequence[tuple[int, float]]


@dataclass(frozen=True)
class Part:
    """A part of the demo.

    Attributes:
        name: Its key in `summary.json`.
        title: What it shows.
        learned_from: What its model learns, or learned, from; a sentence.
        about_s: How long it takes on two idle cores.
        show: Shows it; returns what was measured.
    """

    name: str
    title: str
    learned_from: str
    about_s: float
    show: Callable[[Demo], Awaitable[Sequence[Figure]]]


async def artifacts(client: OrchestratorClient, run_id: str) -> dict[str, bytes]:
    """Returns the artifacts of a run by name."""
    listed = (await client.list_artifacts(ListArtifactsRequest(run_id))).artifacts
    return {each.name: await _artifact(client, run_id, each.name) for each in listed}


async def _artifact(client: OrchestratorClient, run_id: str, name: str) -> bytes:
    return b"".join([part.data async for part in client.get_artifact(GetArtifactRequest(run_id, name))])
