"""Runs without an orchestrator above them: done in this process, or by a child process that is killed."""

import json
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from freerein.fork_server import Program, StartChild
from freerein.jobs.attempt import WAITING_FILE
from freerein.types.common import ModelRef
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.rl.errors import Stopped

_LIMIT_S = 500.0
_MODULE = "freerein_orchestrator.runs"


@dataclass(frozen=True)
class LooseRun:
    """A run of a data directory.

    Attributes:
        kind: Its kind.
        config: Its parsed configuration.
        data_dir: The data directory.
        folder: The run's.
        environ: Where services are.
        start_child: Starts child processes.
    """

    kind: Any
    config: Any
    data_dir: Path
    folder: Path
    environ: Mapping[str, str]
    start_child: StartChild

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The whole rows of metrics so far."""
        path = self.folder / "metrics.jsonl"
        lines = path.read_text().splitlines(keepends=True) if path.is_file() else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    @property
    def waiting(self) -> str:
        """Why the run waits for a service, empty where it does not."""
        path = self.folder / WAITING_FILE
        return path.read_text() if path.is_file() else ""

    @property
    def model(self) -> ModelRef:
        """The model that the run has noted."""
        return ModelRef(**json.loads((self.folder / "model.json").read_bytes()))

    def artifact(self, name: str) -> Any:
        return json.loads((self.folder / "artifacts" / name).read_bytes())

    def do(self, *, stop: Callable[[], bool] = bool, cancelled: bool = False) -> bool:
        """Does the run's work, or resumes it, in this process; returns whether it is done."""
        context = self.context(stop, cancelled=cancelled)
        try:
            with context.closing:
                self.kind.run(context, self.config)
        except Stopped:
            return False
        return True

    def check(self, **earlier: str) -> None:
        """Checks what the run builds on, as before it is queued; `earlier` are the kinds of steps by name."""
        self.kind.check(self.config, PolicyStore.open(self.data_dir, self.environ), earlier)

    def kill_when(self, is_time: Callable[[], bool]) -> None:
        """Starts a child process that does the work, and kills it as soon as it is time."""
        environ = {**os.environ, "OMP_NUM_THREADS": "1", **self.environ}
        arguments = str(self.folder), str(self.data_dir), "cpu"
        stdin, held_open = os.pipe()
        with tempfile.TemporaryFile() as log, os.fdopen(held_open, "wb"), os.fdopen(stdin):
            output = log.fileno()
            child = self.start_child(Program(_MODULE, arguments, environ, stdin, output, output))
            limit = time.monotonic() + _LIMIT_S
            while not is_time():
                assert child.poll() is None, Path(f"/proc/self/fd/{output}").read_text()
                assert time.monotonic() < limit
                time.sleep(0.01)
            child.send_signal(signal.SIGKILL)
            child.wait()

    def context(self, stop: Callable[[], bool] = bool, *, cancelled: bool = False) -> RunContext:
        """Returns the run's context in this process."""
        return RunContext(
            folder=self.folder,
            key=self.folder.name,
            data_dir=self.data_dir,
            device="cpu",
            environ=self.environ,
            stop=stop,
            cancelled=lambda: cancelled,
        )


NewRun = Callable[..., LooseRun]


@pytest.fixture(scope="session")
def new_run(fork_child: StartChild) -> NewRun:
    """A function that makes a run: `new_run(data_dir, "fit", {"dataset": ...}, FREEREIN_SIM_ADDRESS=...)`."""

    def new(data_dir: Path, kind: Any, config: Mapping[str, Any], *, name: str = "", **environ: str) -> LooseRun:
        folder = data_dir / "runs" / (name or os.urandom(16).hex())
        folder.mkdir(parents=True, exist_ok=True)
        chosen = KINDS[kind]
        whole = chosen.dump(chosen.parse(config))
        (folder / "config.json").write_text(json.dumps({"kind": kind, "config": whole}))
        return LooseRun(chosen, chosen.parse(json.loads(json.dumps(whole))), data_dir, folder, environ, fork_child)

    return new


class Mortal:
    """A service that can be killed, and started again at its address.

    Attributes:
        address: Of its gRPC server.
        data_dir: Its data directory.
    """

    def __init__(self, start: Callable[..., Any], module: str, **environ: str) -> None:
        self._start = partial(start, module, **environ)
        self._running = self._start()
        self.address: str = self._running.address
        self.data_dir: Path = self._running.data_dir

    def kill(self) -> None:
        self._running.kill()
        self._running.process.wait()

    def restart(self) -> None:
        """Returns when it is ready: a run that waits asks whether to stop, too."""
        self._running = self._start(FREEREIN_GRPC_PORT=self.address.rpartition(":")[2])
        while not self._running.is_ready():
            time.sleep(0.02)

    def replaced_at(self, count: int, *, since: Callable[[], object] = lambda: True) -> "Replacing":
        return Replacing(self, count, since)


class Replacing:
    """Asked whether to stop, says no; replaces a service when it is asked for the n-th time since something is true.

    Several threads of a run may ask at once.
    """

    def __init__(self, service: Mortal, count: int, since: Callable[[], object]) -> None:
        self._service = service
        self._left = count
        self._since = since
        self._asked = threading.Lock()

    @property
    def is_done(self) -> bool:
        """Whether it was asked again after that."""
        return self._left < 0

    def __call__(self) -> bool:
        with self._asked:
            self._left -= self._left <= 0 or bool(self._since())
            is_time = self._left == 0
        if is_time:
            self._service.kill()
            self._service.restart()
        return False


@pytest.fixture(scope="module")
def mortal(start_module_service: Callable[..., Any]) -> Callable[..., Mortal]:
    """A function that starts a service that tests may kill: `mortal("freerein_sim", NAME="value")`."""
    return partial(Mortal, start_module_service)


@pytest.fixture(scope="module")
def mortal_sim(mortal: Callable[..., Mortal]) -> Mortal:
    """A sim service of a module, which its tests may kill."""
    return mortal("freerein_sim", FREEREIN_SIM_WORKERS="1")
