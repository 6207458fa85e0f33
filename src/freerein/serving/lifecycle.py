"""A service as a process: listens at once, is ready after its warm-up, drains on SIGTERM, exits with code 0.

Exit code 1 means that it must be started again: its model hangs, it met a bug, what it needs failed, or it did not stop
in time. Exit code 3 means a configuration error: starting again cannot help.
"""

import asyncio
import contextlib
import json
import logging
import os
import socket
import sys
import threading
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import grpc
import uvloop
from pydantic import ValidationError

from freerein import program
from freerein.errors import AlreadyExists, FailedPrecondition, InvalidInput, NotFound, ServiceError, Unimplemented
from freerein.jobs.allocator import keep_freed_memory
from freerein.ports import Ports, moved
from freerein.serving import logs
from freerein.serving.environment import reasons
from freerein.serving.grpc_server import GrpcServer
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.memory import Memory
from freerein.serving.methods import Method
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.rest.http_server import HttpServer, make_server
from freerein.serving.rest.web_page import WebPage
from freerein.serving.rest.websocket import OpenSession
from freerein.serving.settings import ServiceSettings

_log = logging.getLogger(__name__)
S = TypeVar("S", bound=ServiceSettings)
CONFIGURATION_ERROR, FAILURE = 3, 1
_CONFIGURATION_ERRORS = (InvalidInput, NotFound, AlreadyExists, FailedPrecondition, Unimplemented)
_HANG_PERIOD_S = 0.5
_END_S = 16.0  # a drain takes 8 s, the last checkpoint of a run 7 s
_BACKLOG = 2048


@dataclass(frozen=True)
class Service:
    """A service as its process sees it.

    Attributes:
        methods: Its methods, served over REST and gRPC.
        start: Warms it up, while the servers already listen.
        close: Releases what it holds.
        not_ready: Returns why it is not ready, empty when it is.
        hangs: Returns whether it can only be helped by a new process.
        open_websocket: Opens a connection of its WebSocket; None for a service without one.
        jobs: Folders of its jobs by kind, `fit` or `run`.
        configs: Returns JSON schemas of the field `config`, by message of a request.
        page: What it has for browsers; None for a service without a page.
    """

    name: str
    methods: tuple[Method, ...]
    start: Callable[[], Awaitable[None]]
    close: Callable[[], Awaitable[None]]
    not_ready: Callable[[], str]
    hangs: Callable[[], bool] = lambda: False
    open_websocket: OpenSession | None = None
    jobs: Mapping[str, Path] = field(default_factory=dict)
    configs: Callable[[], Mapping[str, Any]] = dict
    page: WebPage | None = None


class _DecodeThreads(ThreadPoolExecutor):
    """Threads that the end of the event loop does not wait for."""

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        super().shutdown(wait=False, cancel_futures=True)


Build = Callable[[S, Limits, Metrics, Health], Service]


def run(name: str, settings_class: type[S], build: Build[S]) -> NoReturn:
    """Runs a service until it is told to stop, and ends the process.

    No thread is waited for at the end: one may be in a decoder or a model that hangs, or wait for a database.
    """
    program.loaded()
    logs.configure(name)
    try:
        settings = settings_class()
    except ValidationError as error:
        program.end(_cannot_start(reasons(error), CONFIGURATION_ERROR))
    logs.set_level(settings.log_level)
    keep_freed_memory()
    uvloop.run(_serve_and_end(settings, build))


async def _serve_and_end(settings: S, build: Build[S]) -> NoReturn:
    """Runs a service, and ends the process while the loop runs: calls that gRPC has not begun are UNAVAILABLE so."""
    try:
        code = await _serve(settings, build)
    except ServiceError as error:
        code = CONFIGURATION_ERROR if isinstance(error, _CONFIGURATION_ERRORS) else FAILURE
        code = _cannot_start(f"{error.detail} {error.hint}", code)
    program.end(code)


async def _serve(settings: S, build: Build[S]) -> int:
    threads = _DecodeThreads(max(2, os.cpu_count() or 1), "decode")  # more would starve the event loop
    asyncio.get_running_loop().set_default_executor(threads)
    limits = _limits(settings)
    metrics, memory, token = Metrics(), Memory(limits), settings.token_text
    built: list[Service] = []
    health = Health(lambda: built[0].not_ready() if built else "It is starting.")
    service = build(settings, limits, metrics, health)
    built.append(service)
    metrics.data.data_dir, metrics.data.jobs = settings.data_dir, service.jobs
    app = make_app(
        service.name,
        service.methods,
        health=health,
        metrics=metrics,
        limits=limits,
        memory=memory,
        token=token,
        origins=settings.origins,
        is_local=settings.is_local,
        open_websocket=service.open_websocket,
        configs=service.configs,
        page=service.page,
    )
    grpc_server = GrpcServer(service.methods, health=health, metrics=metrics, limits=limits, memory=memory, token=token)
    ports = _chosen_ports(service.name, settings)
    try:
        listener, grpc_port = _bind_both(grpc_server, settings, ports)
    except (OSError, RuntimeError):
        return _cannot_start(
            f"{settings.host} must be an address of this machine, and its ports {ports.rest} and {ports.grpc} free; "
            "one could not be bound. "
            "Set FREEREIN_HOST, FREEREIN_HTTP_PORT and FREEREIN_GRPC_PORT to others, or stop what holds the ports.",
            CONFIGURATION_ERROR,
        )
    cert, key = (str(path) if path else None for path in (settings.tls_cert, settings.tls_key))
    http_server = make_server(
        app,
        limits=limits,
        health=health,
        cert=cert,
        key=key,
        memory=memory,
        has_websocket=service.open_websocket is not None,
    )
    rest = asyncio.create_task(http_server.serve(sockets=[listener]))
    await grpc_server.server.start()
    _say_ports(service.name, settings.host, http_port=listener.getsockname()[1], grpc_port=grpc_port)
    health_reporter = asyncio.create_task(grpc_server.report_health())
    warm_up = asyncio.create_task(_warm_up(service, http_server, health))
    code = await _wait_for_drain(service, http_server, health)
    _end_within(_END_S)
    _log.info("draining")
    await grpc_server.drain()
    await asyncio.gather(rest, health_reporter)
    await _stop(service, warm_up)
    return code


async def _stop(service: Service, warm_up: "asyncio.Task[None]") -> None:
    warm_up.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await warm_up
    await service.close()
    _log.info("stopped")


def _end_within(seconds: float) -> None:
    """Ends the process with code 1 after some seconds, whatever hangs: threads that are waited for, or the loop."""

    def end() -> None:
        _log.error("did not stop in time")
        program.end(FAILURE)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()


def _say_ports(name: str, host: str, **ports: int) -> None:
    _log.info("listening", extra={"host": host, **ports})
    sys.stdout.write(json.dumps({"service": name, **ports}) + "\n")
    sys.stdout.flush()


def _limits(settings: ServiceSettings) -> Limits:
    return Limits(
        receipt_s=settings.receipt_s,
        write_s=settings.write_s,
        idle_s=settings.idle_s,
        http_keep_alive_s=settings.keep_alive_s,
        ping_s=settings.ping_s,
        drain_delay_s=settings.drain_delay_s,
        unary_s=settings.unary_s,
        queue=settings.queue,
    )


async def _warm_up(service: Service, http_server: HttpServer, health: Health) -> None:
    try:
        await service.start()
        _log.info("ready" if not health.reason() else "open", extra={"reason": health.reason()})
    except BaseException:
        health.drain()
        http_server.should_exit = True
        raise


async def _wait_for_drain(service: Service, http_server: HttpServer, health: Health) -> int:
    """Waits until the graceful shutdown begins, and begins it when the service hangs; returns the exit code."""
    while not health.draining:
        if service.hangs():
            _log.error("hangs", extra={"reason": health.reason()})
            health.drain()
            http_server.should_exit = True
            return FAILURE
        await health.await_or_drain(asyncio.sleep(_HANG_PERIOD_S))
    return 0


def _chosen_ports(name: str, settings: ServiceSettings) -> Ports:
    rest, grpc_port = settings.http_port, settings.grpc_port
    if rest is not None and grpc_port is not None:
        return Ports(rest, grpc_port)
    default = moved(name, settings.port_base)
    return Ports(default.rest if rest is None else rest, default.grpc if grpc_port is None else grpc_port)


def _bind_both(grpc_server: GrpcServer, settings: ServiceSettings, ports: Ports) -> tuple[socket.socket, int]:
    """Returns the listening socket of the REST API, and the port that the gRPC server is bound to."""
    _bind(settings.host, ports.grpc).close()  # gRPC itself would also print on stderr that the port is in use
    listener = _bind(settings.host, ports.rest)
    try:
        listener.listen(_BACKLOG)
        return listener, _bind_grpc(grpc_server, settings, ports.grpc)
    except BaseException:
        listener.close()
        raise


def _bind(host: str, port: int) -> socket.socket:
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except BaseException:
        bound.close()
        raise
    return bound


def _bind_grpc(grpc_server: GrpcServer, settings: ServiceSettings, port: int) -> int:
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    address = f"{host}:{port}"
    if settings.tls_cert is None or settings.tls_key is None:
        return grpc_server.server.add_insecure_port(address)
    pair = (settings.tls_key.read_bytes(), settings.tls_cert.read_bytes())
    return grpc_server.server.add_secure_port(address, grpc.ssl_server_credentials([pair]))


def _cannot_start(reason: str, code: int) -> int:
    sys.stderr.write(f"cannot start: {reason}\n")
    return code
