"""Runs services as child processes on this machine, for `up`, `demo` and the end-to-end tests.

async with Stack(choose(()), data_dir=Path("var"), environ=os.environ) as stack:
    await stack.ready(timeout_s=30)
    sim = SimClient(Channel(stack.addresses["sim"]))
"""

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import aclosing
from pathlib import Path
from typing import Self

import httpx

from freerein.errors import DeadlineExceeded, FailedPrecondition
from freerein.ports import PORTS, Ports
from freerein.stack.certificates import tls_context
from freerein.stack.endpoints import configured_host, connectable, hold
from freerein.stack.process import RestartPolicy, ServiceCommand, ServiceProcess, ServiceStatus

_RESTARTS = RestartPolicy()
_PROBE_TIMEOUT_S = 2.0


class Stack:
    """Services that run within `async with`, and are drained at its end.

    Their ports are bound here as well, so that no other program is given one. The services die with this process and
    with the thread of its event loop. They log to `<data_dir>/logs/<service>.log`.

    Args:
        services: Module for `python -m` by service; see `choose`.
        data_dir: Their data directory.
        environ: Their environment; ports, data directory and missing addresses are added.
        ports: By service, such as `free_ports` returns; None for the standard ports.
        policy: When to restart a service that crashed.

    Attributes:
        addresses: gRPC address by service, `host:port`.
        urls: REST URL by service.
    """

    def __init__(
        self,
        services: Mapping[str, str],
        *,
        data_dir: Path,
        environ: Mapping[str, str],
        ports: Mapping[str, Ports] | None = None,
        policy: RestartPolicy = _RESTARTS,
    ) -> None:
        self._ports = {name: (ports or PORTS)[name] for name in services}
        self._host = configured_host(environ)
        host = connectable(self._host)
        certificate = environ.get("FREEREIN_TLS_CERT")
        scheme = "https" if certificate else "http"
        self.addresses = {name: f"{host}:{pair.grpc}" for name, pair in self._ports.items()}
        self.urls = {name: f"{scheme}://{host}:{pair.rest}" for name, pair in self._ports.items()}
        self._changed = asyncio.Event()
        self._client = httpx.AsyncClient(timeout=_PROBE_TIMEOUT_S, trust_env=False, verify=tls_context(certificate))
        self._tasks: list[asyncio.Task[None]] = []
        shared = {**environ, "FREEREIN_DATA_DIR": str(data_dir)}
        for name, target in self.addresses.items():
            variable, url = (f"FREEREIN_{name.upper()}_{kind}" for kind in ("ADDRESS", "URL"))
            if not environ.get(variable):
                shared.update({variable: target, url: environ.get(url) or self.urls[name]})
        self._processes = [
            ServiceProcess(
                ServiceCommand(module, _environ(shared, self._ports[name]), data_dir / "logs" / f"{name}.log"),
                ServiceStatus(name, "starting", self.urls[name], self.addresses[name]),
                policy,
                client=self._client,
                on_change=self._on_change,
            )
            for name, module in services.items()
        ]

    @property
    def statuses(self) -> tuple[ServiceStatus, ...]:
        """Current status of each service."""
        return tuple(process.status for process in self._processes)

    async def watch(self) -> AsyncGenerator[tuple[ServiceStatus, ...], None]:
        """Yields the statuses, now and after every change; raises OSError where a service's log cannot be written."""
        while True:
            changed = self._changed
            for task in self._tasks:
                if task.done():
                    task.result()
            yield self.statuses
            await changed.wait()

    async def ready(
        self, *, timeout_s: float, on_change: Callable[[tuple[ServiceStatus, ...]], None] = lambda _: None
    ) -> None:
        """Waits until every service is ready, and calls `on_change` with the statuses, now and after every change.

        Raises FailedPrecondition or DeadlineExceeded.
        """
        try:
            async with asyncio.timeout(timeout_s), aclosing(self.watch()) as changes:
                async for statuses in changes:
                    on_change(statuses)
                    _raise_if_failed(statuses)
                    if all(status.state == "ready" for status in statuses):
                        return
        except TimeoutError:
            waiting = "; ".join(f"{each.service}: {each.reason}" for each in self.statuses if each.state != "ready")
            raise DeadlineExceeded(
                f"All services must be ready within {timeout_s:g} s; got {waiting}", hint=_SEE_LOG
            ) from None

    async def __aenter__(self) -> Self:
        """Starts the services; raises FailedPrecondition where a port is in use."""
        self._held = hold(self._ports, host=self._host)
        self._tasks = [asyncio.create_task(process.run()) for process in self._processes]
        for task in self._tasks:
            task.add_done_callback(lambda _: self._on_change())
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        results = await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._client.aclose()
        self._held.close()
        for result in results:
            if isinstance(result, Exception):
                raise result

    def _on_change(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()


_SEE_LOG = "Read logs/<service>.log in the data directory, or run `freerein doctor`."


def _raise_if_failed(statuses: tuple[ServiceStatus, ...]) -> None:
    for status in statuses:
        if status.has_failed:
            raise FailedPrecondition(
                f"The {status.service} service must start; it is {status.state}: {status.reason}", hint=_SEE_LOG
            )


def _environ(shared: Mapping[str, str], ports: Ports) -> dict[str, str]:
    return {**shared, "FREEREIN_HTTP_PORT": str(ports.rest), "FREEREIN_GRPC_PORT": str(ports.grpc)}
