"""What every part of the demo works with: the running services, a folder for what comes out, the seed, the screen."""

from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path

from freerein.cli.connection import channel_to
from freerein.cli.demo.door import Door
from freerein.cli.demo.screen import Screen
from freerein.cli.recording import record
from freerein.cli.services import Doors
from freerein.cli.settings import CliSettings
from freerein.clients import Channel, OrchestratorClient, SimClient
from freerein.data import dataset_path
from freerein.types.sim import DemonstrateRequest

HELD_OUT = 1_000_000
"""Added to the seed of what is held out: none of it was trained on."""


@dataclass(frozen=True, eq=False)
class Context:
    """Where the demo runs.

    Attributes:
        doors: Of the services.
        settings: The token that they ask for, and the certificate that they are to have.
        data_dir: Where the services find datasets.
        out: The folder for all that comes out.
        seed: Seed of every draw.
        screen: What a person sees.
    """

    doors: Doors
    settings: CliSettings
    data_dir: Path
    out: Path
    seed: int
    screen: Screen

    def dataset(self, name: str) -> Path:
        """Returns where a dataset lies."""
        return dataset_path(self.data_dir, name)

    def door(self, service: str) -> AbstractAsyncContextManager[Door]:
        """Returns the REST door of a service."""
        url = self.doors.urls[service]
        return Door(url, self.settings, requests=self.out / "requests", screen=self.screen)

    def channel(self, service: str) -> Channel:
        """Returns a connection to the gRPC door of a service."""
        return channel_to(self.doors.addresses[service], self.settings)

    def sim(self) -> SimClient:
        """Returns a client of the sim service."""
        return SimClient(self.channel("sim"))

    def orchestrator(self) -> OrchestratorClient:
        """Returns a client of the orchestrator."""
        return OrchestratorClient(self.channel("orchestrator"))

    async def record(self, name: str, request: DemonstrateRequest) -> None:
        """Records what a behaviour does into a dataset."""
        self.screen.call(_command(name, request))
        with self.screen.progress(name, request.count) as advance:
            async with self.sim() as client:
                await record(client, request, self.dataset(name), on_count=advance)


def _command(name: str, request: DemonstrateRequest) -> str:
    """Returns what one would type to record the same."""
    words = f"freerein sim demonstrate {request.task} --out {name} --count {request.count} --seed {request.seed}"
    if request.behaviour == "random":
        return f"{words} --behaviour random"
    skills = f"--min-skills {request.min_skills} --max-skills {request.max_skills}"
    return f"{words} {skills}" + " --truth" * request.privileged
