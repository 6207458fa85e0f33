"""A supervised service process: started, probed, restarted after a crash, drained at the end."""

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

from freerein.stack.certificates import tls_problem

CONFIGURATION_ERROR = 3
DRAIN_S = 17.0
"""A service ends within 16 s of SIGTERM: calls in flight take 8, the last checkpoint of a run 7."""

State = Literal["starting", "not ready", "ready", "restarting", "given up", "misconfigured", "stopped"]

_POLL_S = 0.1
_POLL_WHEN_READY_S = 1.0
_TLS_TIMEOUT_S = 2.0
_CONFIGURATION_ERROR_PREFIX = "cannot start: "
_LOG_END = 4096
"""Bytes of a log among which the error of a start is."""


@dataclass(frozen=True)
class ServiceStatus:
    """State of a service process.

    Attributes:
        state: `given up` after too many crashes and `misconfigured` after a configuration error are final.
        pid: 0 while there is no process.
        reason: Why the service is not ready; empty when it is.
    """

    service: str
    state: State
    rest_url: str
    grpc_address: str
    pid: int = 0
    restarts: int = 0
    reason: str = ""

    @property
    def has_failed(self) -> bool:
        """Whether it will not be restarted."""
        return self.state in ("given up", "misconfigured")


@dataclass(frozen=True)
class RestartPolicy:
    """Exponential backoff of restarts, and when to give up.

    Attributes:
        first_delay_s: Delay before the first restart; it doubles with each further one.
        longest_delay_s: Upper bound of the delay.
        crashes: Number of crashes after which a service that has not been ready is given up.
        window_s: Delay before the next restart, in seconds, where there were as many crashes in as many seconds.
    """

    first_delay_s: float = 0.5
    longest_delay_s: float = 5.0
    crashes: int = 5
    window_s: float = 60.0


@dataclass(frozen=True)
class ServiceCommand:
    """How to start a service process: the module for `python -m`, the whole environment, and the log of its output."""

    module: str
    environ: Mapping[str, str]
    log: Path


class ServiceProcess:
    """Keeps a service running while `run` runs; `on_change` is called after each change of its `status`."""

    def __init__(
        self,
        command: ServiceCommand,
        status: ServiceStatus,
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
        self._crashes_unready = 0

    async def run(self) -> None:
        """Keeps the service running until it has failed; drains it when cancelled."""
        try:
            await self._keep_running()
        except asyncio.CancelledError:
            self._change(state="stopped", pid=0, reason="")
            raise

    async def _keep_running(self) -> None:
        while True:
            code = await self._run_once()
            self._crashes.append(time.monotonic())
            self._crashes_unready += 1
            reason = f"It was killed by signal {-code}." if code < 0 else f"It exited with code {code}."
            if code == CONFIGURATION_ERROR:
                self._change(state="misconfigured", pid=0, reason=_configuration_error(self._command.log))
                return
            if self._crashes_unready >= self._policy.crashes:
                self._change(state="given up", pid=0, reason=f"{reason} Its log says why.")
                return
            self._change(state="restarting", pid=0, reason=reason)
            await asyncio.sleep(self._delay_s())
            self._change(state="starting", restarts=self.status.restarts + 1)

    async def _run_once(self) -> int:
        """Runs one process of the service; returns its exit code. When cancelled, drains it first."""
        self._command.log.parent.mkdir(parents=True, exist_ok=True)
        with self._command.log.open("ab") as log:
            process = await asyncio.create_subprocess_exec(
                *(
                    sys.executable,
                    "-m",
                    "freerein.die_with_parent",
                    str(os.getpid()),
                    self._command.module,
                ),
                env=self._command.environ,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # so that Ctrl-C reaches only the parent, which drains the services
            )
        self._change(pid=process.pid)
        watch = asyncio.create_task(self._watch_readiness())
        try:
            return await process.wait()
        except asyncio.CancelledError:
            watch.cancel()
            delay_s = float(self._command.environ.get("FREEREIN_DRAIN_DELAY_S") or 0)
            await _drain(process, timeout_s=DRAIN_S + delay_s)
            raise
        finally:
            watch.cancel()
            _kill_group(process.pid)  # what it started and did not put into a group of its own

    async def _watch_readiness(self) -> None:
        while True:
            state, reason = await self._readiness()
            if state == "ready":
                self._crashes_unready = 0
            self._change(state=state, reason=reason)
            await asyncio.sleep(_POLL_WHEN_READY_S if state == "ready" else _POLL_S)

    async def _readiness(self) -> tuple[State, str]:
        try:
            answer = await self._client.get(f"{self.status.rest_url}/readyz")
            if answer.is_success and (problem := await self._tls_problem()):
                return "not ready", problem
            return ("ready", "") if answer.is_success else ("not ready", str(answer.json()["detail"]))
        except httpx.ConnectError:
            problem = await self._tls_problem()
            return ("not ready", problem) if problem else ("starting", "It does not listen yet.")
        except (httpx.HTTPError, ValueError, KeyError, TypeError):
            return "not ready", "It does not answer the readiness probe."

    async def _tls_problem(self) -> str:
        """Returns why clients cannot speak TLS with the service; empty where they can, and once it was ready."""
        certificate, url = self._command.environ.get("FREEREIN_TLS_CERT"), httpx.URL(self.status.rest_url)
        if not certificate or self.status.state == "ready":
            return ""
        target = self._command.environ.get(f"FREEREIN_{self.status.service.upper()}_ADDRESS", "")
        called = target.partition(",")[0].strip().rpartition(":")[0]
        return await asyncio.to_thread(
            tls_problem, url.host, url.port or 0, certificate, called=called, timeout_s=_TLS_TIMEOUT_S
        )

    def _delay_s(self) -> float:
        recent = sum(self._crashes[-1] - crash <= self._policy.window_s for crash in self._crashes)
        if recent == self._policy.crashes:
            return self._policy.window_s
        return min(self._policy.longest_delay_s, self._policy.first_delay_s * 2.0 ** (recent - 1))

    def _change(self, **changes: object) -> None:
        changed = replace(self.status, **changes)  # type: ignore[arg-type]  # fields of ServiceStatus
        if changed != self.status:
            self.status = changed
            self._on_change()


async def _drain(process: asyncio.subprocess.Process, *, timeout_s: float) -> None:
    """Terminates a process; kills it after a while, in seconds."""
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    try:
        await asyncio.wait_for(process.wait(), timeout_s)
    except TimeoutError:
        _kill_group(process.pid)
        await process.wait()


def _kill_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def _configuration_error(log: Path) -> str:
    """Returns the service's own error: the last line of its log."""
    with log.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - _LOG_END))
        lines = file.read().decode(errors="replace").splitlines()
    return lines[-1].removeprefix(_CONFIGURATION_ERROR_PREFIX) if lines else ""
