"""Runs without an orchestrator above them: done in this process, or by a child process that is killed."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from freerein.jobs.attempt import WAITING_FILE
from freerein.types.common import ModelRef
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.kinds.context import RunContext
from freerein_orchestrator.kinds.policy_store import PolicyStore
from freerein_orchestrator.rl.errors import Stopped

_LIMIT_S = 500.0


@dataclass(frozen=True)
class LooseRun:
    """A run of a data directory.

    Attributes:
        kind: Its kind.
        config: Its parsed configuration.
        data_dir: The data directory.
        folder: The run's.
        environ: Where services are.
    """

    kind: Any
    config: Any
    data_dir: Path
    folder: Path
    environ: Mapping[str, str]

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

    def check(self, *earlier: str) -> None:
        """Checks what the run builds on, as before it is queued."""
        self.kind.check(self.config, PolicyStore.open(self.data_dir, self.environ), earlier)

    def kill_when(self, is_time: Callable[[], bool]) -> None:
        """Starts a child process that does the work, and kills it as soon as it is time."""
        command = [
            sys.executable,
            "-m",
            "freerein_orchestrator.runs",
            str(self.folder),
            str(self.data_dir),
            "cpu",
        ]
        environ = {**os.environ, "OMP_NUM_THREADS": "1", **self.environ}
        limit = time.monotonic() + _LIMIT_S
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, env=environ) as child:
            assert child.stderr is not None
            while not is_time():
                assert child.poll() is None, child.stderr.read()
                assert time.monotonic() < limit
                time.sleep(0.005)
            child.kill()

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


@pytest.fixture
def new_run() -> NewRun:
    """A function that makes a run: `new_run(data_dir, "fit", {"dataset": ...}, FREEREIN_SIM_ADDRESS=...)`."""

    def new(data_dir: Path, kind: Any, config: Mapping[str, Any], *, name: str = "", **environ: str) -> LooseRun:
        folder = data_dir / "runs" / (name or os.urandom(16).hex())
        folder.mkdir(parents=True, exist_ok=True)
        chosen = KINDS[kind]
        whole = chosen.dump(chosen.parse(config))
        (folder / "config.json").write_text(json.dumps({"kind": kind, "config": whole}))
        return LooseRun(chosen, chosen.parse(json.loads(json.dumps(whole))), data_dir, folder, environ)

    return new
