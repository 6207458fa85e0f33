"""One service as a child process: started, watched, started again when it crashes, drained when it is to end."""

import asyncio
import contextlib
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import httpx

CONFIGURATION_ERROR = 3
DRAIN_S = 10.0

State = Literal["starting", "not ready", "ready", "restarting", "given up", "misconfigured", "stopped"]

_POLL_S = 0.1
_POLL_WHEN_READY_S = 1.0
_COMPLAINT = "cannot start: "


@dataclass(frozen=True)
class Status:
    """How a service stands.

    Attributes:
        service: Its name.
        state: `given up` after too many crashes, `misconfigured` after an exit that says so: neither is started again.
        rest_url: Where its REST door is.
        grpc_address: Where its gRPC door is, `host:port`.
        pid: Its process; 0 while there is none.
        restarts: How often it was started again.
        reason: Why it is not ready; empty when it is.
    """

    service: str
    state: State
    rest_url: str
    grpc_address: str
    pid: int = 0
    restarts: int = 0
    reason: str = ""

    @property
    def is_hopeless(self) -> bool:
        """Whether it will not be started again."""
        return self.state in ("given up", "misconfigured")


@dataclass(frozen=True)
class RestartPolicy:
    """When a service that crashed is started again.

    Attributes:
        first_delay_s: Before the first restart; each further one waits twice as long.
        longest_delay_s: No restart waits longer.
        crashes: It is given up after this many crashes,
        window_s: within this many seconds.
    """

    first_delay_s: float = 0.5
    longest_delay_s: float = 5.0
    crashes: int = 5
    window_s: float = 60.0


@dataclass(frozen=True)
class Command:
    """What a child process is.

    Attributes:
        module: What `python -m` runs.
        environ: Its whole environment.
        log: What it prints is appended here.
    """

    module: str
    environ: Mapping[str, str]
    log: Path


class Child:
    """Runs a service for as long as `run` does.

    Args:
        command: What to run.
        status: How it stands before it is started.
        policy: When to start it again.
        client: Asks whether it is ready.
        on_change: Called after each change of `status`.

    Attributes:
        status: How the service stands.
    """

    def __init__(
        self,
        command: Command,
        status: Status,
        policy: RestartPolicy,
        *,
        client: httpx.AsyncClient,
        on_change: Callable[[], None],
    ) -> None:
        self.status = status
        self._command = command
        self._policy = policy
        self._client = client
        self._on_change = on_change
        self._crashes: deque[float] = deque(maxlen=policy.crashes)

    async def run(self) -> None:
        """Keeps the service running until it is hopeless; drains it when cancelled."""
        try:
            await self._keep_running()
        except asyncio.CancelledError:
            self._change(state="stopped", pid=0, reason="")
            raise

    async def _keep_running(self) -> None:
        while True:
            code = await self._run_once()
            self._crashes.append(time.monotonic())
            reason = f"It was ended by signal {-code}." if code < 0 else f"It ended with exit code {code}."
            if code == CONFIGURATION_ERROR:
                self._change(state="misconfigured", pid=0, reason=_complaint(self._command.log))
                return
            if self._has_crashed_too_often():
                self._change(state="given up", pid=0, reason=f"{reason} Its log says why.")
                return
            self._change(state="restarting", pid=0, reason=reason)
            await asyncio.sleep(self._delay_s())
            self._change(state="starting", restarts=self.status.restarts + 1)

    async def _run_once(self) -> int:
        """Returns the exit code of one process of the service; when cancelled, the process has ended."""
        self._command.log.parent.mkdir(parents=True, exist_ok=True)
        with self._command.log.open("ab") as log:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "freerein.cli.tether", str(os.getpid()), self._command.module),
                env=self._command.environ,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # a terminal's Ctrl-C is for the parent, which drains everything in order
            )
        self._change(pid=process.pid)
        watch = asyncio.create_task(self._watch_readiness())
        try:
            return await process.wait()
        except asyncio.CancelledError:
            watch.cancel()
            await _drain(process)
            raise
        finally:
            watch.cancel()
            _kill_group(process.pid)  # its workers and training children: the next process starts its own

    async def _watch_readiness(self) -> None:
        while True:
            state, reason = await self._readiness()
            self._change(state=state, reason=reason)
            await asyncio.sleep(_POLL_WHEN_READY_S if state == "ready" else _POLL_S)

    async def _readiness(self) -> tuple[State, str]:
        try:
            answer = await self._client.get(f"{self.status.rest_url}/readyz")
            return ("ready", "") if answer.is_success else ("not ready", str(answer.json()["detail"]))
        except httpx.ConnectError:
            return "starting", "Its doors are not open yet."
        except (httpx.HTTPError, ValueError, KeyError, TypeError):
            return "not ready", "It does not answer as a service does."

    def _has_crashed_too_often(self) -> bool:
        is_full = len(self._crashes) == self._policy.crashes
        return is_full and self._crashes[-1] - self._crashes[0] <= self._policy.window_s

    def _delay_s(self) -> float:
        recent = sum(self._crashes[-1] - crash <= self._policy.window_s for crash in self._crashes)
        return min(self._policy.longest_delay_s, self._policy.first_delay_s * 2.0 ** (recent - 1))

    def _change(self, **changes: object) -> None:
        changed = replace(self.status, **changes)  # type: ignore[arg-type]  # fields of Status
        if changed != self.status:
            self.status = changed
            self._on_change()


async def _drain(process: asyncio.subprocess.Process) -> None:
    """Tells a process to end, and ends it when it does not."""
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), DRAIN_S)
    except TimeoutError:
        _kill_group(process.pid)
        await process.wait()


def _kill_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def _complaint(log: Path) -> str:
    """Returns why a service said that it cannot start: the last line of its log."""
    lines = log.read_bytes()[-4096:].decode(errors="replace").splitlines()
    return lines[-1].removeprefix(_COMPLAINT) if lines else ""
