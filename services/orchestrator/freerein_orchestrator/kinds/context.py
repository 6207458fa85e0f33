"""The context of a run in its child process: folders, services, metrics, and when to stop."""

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from freerein.atomic_files import write_atomic
from freerein.clients import (
    Channel,
    FitClient,
    ImitationClient,
    RewardClient,
    SegmentationClient,
    SimClient,
    SyncClient,
)
from freerein.clients.rpc import Client
from freerein.jobs.attempt import WAITING_FILE
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.ports import address, addresses
from freerein.types.common import ModelRef
from freerein_orchestrator.envs.retry import Retry
from freerein_orchestrator.kinds.metrics_logger import MetricsLogger
from freerein_orchestrator.kinds.policy_store import PolicyStore

_CLIENTS: Mapping[str, type[Client]] = {
    "imitation": ImitationClient,
    "reward": RewardClient,
    "segmentation": SegmentationClient,
    "sim": SimClient,
}


@dataclass(frozen=True, eq=False)
class RunContext:
    """A run, or one step of a pipeline, as its child process sees it.

    Attributes:
        folder: Its own folder, with `checkpoints/` and `artifacts/`.
        key: Idempotency key for what it requests from services: the run's id, with the names of its steps.
        data_dir: The data directory.
        device: `auto`, `cpu` or `cuda:N`.
        environ: Says where services are.
        stop: Whether to stop; asked often.
        cancelled: Whether it is to stop because the run was cancelled.
        parents: Folders of the enclosing pipeline's runs, outermost first; empty for a whole run.
        first_step: Steps of the run before this one's.
        prefix: Prefix of the metrics' names.
        closing: Closed when the work has ended.
        clients: Open clients by class and address.
    """

    folder: Path
    key: str
    data_dir: Path
    device: str
    environ: Mapping[str, str]
    stop: Callable[[], bool]
    cancelled: Callable[[], bool] = lambda: False
    parents: tuple[Path, ...] = ()
    first_step: int = 0
    prefix: str = ""
    closing: ExitStack = field(default_factory=ExitStack)
    clients: dict[tuple[type[Client], str], SyncClient] = field(default_factory=dict)

    @property
    def artifacts(self) -> Path:
        """Folder of the files that the run leaves; made when missing."""
        folder = self.folder / "artifacts"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    @property
    def run_folder(self) -> Path:
        """Folder of the whole run."""
        return (*self.parents, self.folder)[0]

    @property
    def policies(self) -> PolicyStore:
        """The policies and runs that it may build on, earlier steps of its pipeline included."""
        siblings = self.folder.parent if self.parents else None
        pins = self.folder / "checkpoints" / "pinned.json"
        return PolicyStore.open(self.data_dir, self.environ, siblings=siblings, pins=pins)

    @property
    def reward_models(self) -> ModelStore:
        """The models of the reward service, whose encoders policies see with."""
        shipped = Path(self.environ.get("FREEREIN_SHIPPED_DIR") or CLONE_MODELS).expanduser()
        return ModelStore(self.data_dir / "models" / "reward", shipped=shipped / "reward")

    def retry(self) -> Retry:
        """Returns what repeats work until services are available and the run is not to stop."""
        return Retry(np.random.default_rng(), stop=self.stop, tell=self.tell_wait)

    def client(self, service: str) -> SyncClient:
        """Returns a blocking client of a service."""
        return self._connect(_CLIENTS[service], address(service, self.environ))

    def replicas(self, service: str) -> tuple[SyncClient, ...]:
        """Returns a blocking client per replica: `FREEREIN_<SERVICE>_ADDRESS` may name several."""
        return tuple(self._connect(_CLIENTS[service], each) for each in addresses(service, self.environ))

    def fits(self, service: str) -> SyncClient:
        """Returns a blocking `FitClient` of a service."""
        return self._connect(FitClient, address(service, self.environ))

    def metrics_logger(self, last_step: int, *, group: str = "train") -> MetricsLogger:
        """Returns the log of the run's metrics, after those up to `last_step` of this step; see `MetricsLogger`."""
        return MetricsLogger(
            self.run_folder, last_step=last_step, first_step=self.first_step, prefix=self.prefix, group=group
        )

    def record_model(self, model: ModelRef) -> None:
        """Records, durably, the model that this run has made for a service."""
        for folder in (self.folder, *self.parents):
            write_atomic(folder / "model.json", json.dumps(asdict(model)).encode())

    def log_line(self, text: str) -> None:
        """Writes a line to the run's log, unless the disk is full."""
        with suppress(OSError):
            sys.stderr.write(f"{text}\n")
            sys.stderr.flush()

    def tell_wait(self, reason: str) -> None:
        """Tells why the run waits, in its log and to those who watch it; an empty reason when it goes on."""
        if reason:
            self.log_line(reason)
        with suppress(OSError):
            write_atomic(self.run_folder / WAITING_FILE, reason.encode())

    def child(self, name: str, *, first_step: int) -> "RunContext":
        """Returns the context of one step, in a folder of its own, with metrics named `<name>/<metric>`.

        Args:
            name: The step's name.
            first_step: Steps of this context before the child's.
        """
        return replace(
            self,
            folder=self.folder / "parts" / name,
            key=f"{self.key}.{name}",
            parents=(*self.parents, self.folder),
            first_step=self.first_step + first_step,
            prefix=f"{self.prefix}{name}/",
            closing=self.closing.enter_context(ExitStack()),
            clients={},
        )

    def _connect(self, client: type[Client], where: str) -> SyncClient:
        if found := self.clients.get((client, where)):
            return found
        certificate = self.environ.get("FREEREIN_TLS_CERT", "")
        channel = Channel(
            where,
            token=self.environ.get("FREEREIN_TOKEN", ""),
            root_certificates=Path(certificate).expanduser().read_bytes() if certificate else None,
        )
        connected = SyncClient(client(channel))
        self.closing.callback(connected.close)
        self.clients[client, where] = connected
        return connected
