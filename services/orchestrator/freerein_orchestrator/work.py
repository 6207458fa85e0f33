"""What the child process of a run works with: its folder, its configuration, the services, and when to stop."""

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.clients import (
    Channel,
    FitClient,
    ImitationClient,
    ModelClient,
    RewardClient,
    SegmentationClient,
    SimClient,
    SyncClient,
)
from freerein.clients.channel import Client
from freerein.errors import InvalidInput
from freerein.ports import address, addresses
from freerein.types.common import ModelRef, check_name
from freerein_orchestrator.curve import Curve

_CLIENTS: Mapping[str, type[Client]] = {
    "imitation": ImitationClient,
    "reward": RewardClient,
    "segmentation": SegmentationClient,
    "sim": SimClient,
}


@dataclass(frozen=True, eq=False)
class Work:
    """A run, as its child process sees it.

    Attributes:
        folder: The run's; `checkpoints/` and `artifacts/` in it are the work's own.
        key: The run's id, and that of a part with its name: an idempotency key for what it asks of services.
        config: What `resolve` of its kind returned.
        data_dir: Where datasets, models and all runs lie.
        device: `auto`, `cpu` or `cuda:N`.
        environ: Says where services are.
        stop: Whether to end; asked often.
        cancelled: Whether it is to stop because the run was cancelled: nobody goes on with it soon.
        around: The folders of what this is a part of, the run's first; none of a whole run.
        first_step: Steps of the run before this part's.
        prefix: Of the names of this part's metrics.
        closing: What is closed when the work has ended.
    """

    folder: Path
    key: str
    config: Mapping[str, Any]
    data_dir: Path
    device: str
    environ: Mapping[str, str]
    stop: Callable[[], bool]
    cancelled: Callable[[], bool] = lambda: False
    around: tuple[Path, ...] = ()
    first_step: int = 0
    prefix: str = ""
    closing: ExitStack = field(default_factory=ExitStack)

    @property
    def artifacts(self) -> Path:
        """Where the files lie that the run leaves behind; made when missing."""
        folder = self.folder / "artifacts"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def run(self) -> Path:
        """The folder of the whole run."""
        return (*self.around, self.folder)[0]

    def client(self, service: str) -> SyncClient:
        """Returns a blocking client of a service."""
        return self._connect(_CLIENTS[service], address(service, self.environ))

    def clients(self, service: str) -> tuple[SyncClient, ...]:
        """Returns a blocking client of each replica of a service: `FREEREIN_<SERVICE>_ADDRESS` may name several."""
        return tuple(self._connect(_CLIENTS[service], each) for each in addresses(service, self.environ))

    def fits(self, service: str) -> SyncClient:
        """Returns a blocking `FitClient` of a service."""
        return self._connect(FitClient, address(service, self.environ))

    def models(self, service: str) -> SyncClient:
        """Returns a blocking `ModelClient` of a service."""
        return self._connect(ModelClient, address(service, self.environ))

    def curve(self, *, last_step: int) -> Curve:
        """Returns what the run's metrics are written to, after those up to `last_step` of this part."""
        curve = Curve(self.run, last_step=last_step, first_step=self.first_step, prefix=self.prefix)
        self.closing.callback(curve.close)
        return curve

    def note_model(self, model: ModelRef) -> None:
        """Notes, durably, the model that this work, and so what it is a part of, has made for a service."""
        for folder in (self.folder, *self.around):
            write_atomic(folder / "model.json", json.dumps(asdict(model)).encode())

    def say(self, text: str) -> None:
        """Writes a line to the run's log, where the disk is not full."""
        with suppress(OSError):
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def part(self, name: str, config: Mapping[str, Any], *, first_step: int) -> "Work":
        """Returns a part of this work, in a folder of its own within the run's, with metrics `<name>/<metric>`.

        What it opens is closed with this work, or earlier by its own `closing`.

        Args:
            name: Of the part.
            config: What `resolve` of its kind returned.
            first_step: Steps of this work before the part's.
        """
        return replace(
            self,
            folder=self.folder / "parts" / name,
            key=f"{self.key}.{name}",
            config=config,
            around=(*self.around, self.folder),
            first_step=self.first_step + first_step,
            prefix=f"{self.prefix}{name}/",
            closing=self.closing.enter_context(ExitStack()),
        )

    def run_folder(self, name: str) -> Path:
        """Returns the folder of another run, by its id, or of a part of the same pipeline, by its name.

        Raises:
            InvalidInput: There is neither.
        """
        check_name(name, field="config")
        for folder in (self.folder.parent / name, self.data_dir / "runs" / name):
            if folder.is_dir():
                return folder
        raise InvalidInput(
            "A run to build on must be there, or be an earlier step of the pipeline; there is none of that name.",
            field="config",
            hint="`freerein runs list` names the runs.",
        )

    def _connect(self, client: type[Client], where: str) -> SyncClient:
        channel = Channel(
            where,
            token=self.environ.get("FREEREIN_TOKEN", ""),
            root_certificates=_certificates(self.environ.get("FREEREIN_TLS_CERT", "")),
        )
        connected = SyncClient(client(channel))
        self.closing.callback(connected.close)
        return connected


def _certificates(path: str) -> bytes | None:
    return Path(path).read_bytes() if path else None
