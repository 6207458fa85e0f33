"""A service as a process: doors open at once, ready when warm, drained on SIGTERM, exit 0.

Exit code 3 says that the configuration is at fault and that starting again will not help.
"""

import asyncio
import contextlib
import json
import logging
import os
import socket
import sys
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import grpc
import uvloop
from pydantic import ValidationError

from freerein.errors import ServiceError
from freerein.serving import http, logs
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import Method
from freerein.serving.metrics import Metrics
from freerein.serving.rest import make_app
from freerein.serving.rpc import GrpcServer
from freerein.serving.settings import ServiceSettings

_log = logging.getLogger(__name__)
S = TypeVar("S", bound=ServiceSettings)
CONFIGURATION_ERROR = 3
_BACKLOG = 2048


@dataclass(frozen=True)
class Service:
    """What a service's `build` returns: a core, as far as a process needs to know it.

    Attributes:
        name: Its name.
        methods: What both doors answer.
        start: Warms it up, in the background while the doors are open already.
        close: Ends what it runs.
        not_ready: Returns why it is not ready, empty when it is.
    """

    name: str
    methods: tuple[Method, ...]
    start: Callable[[], Awaitable[None]]
    close: Callable[[], Awaitable[None]]
    not_ready: Callable[[], str]


Build = Callable[[S, Limits, Metrics, Health], Service]


def run(name: str, settings_class: type[S], build: Build[S]) -> int:
    """Runs a service until it is told to stop.

    Returns:
        The process's exit code.
    """
    logs.configure(name)
    try:
        settings = settings_class()  # type: ignore[call-arg]  # every value comes from the environment or has a default
    except ValidationError as error:
        return _complain(_reason(error))
    try:
        return uvloop.run(_serve(settings, build))
    except ServiceError as error:
        return _complain(f"{error.detail} {error.hint}")


async def _serve(settings: S, build: Build[S]) -> int:
    threads = ThreadPoolExecutor(max(2, os.cpu_count() or 1), "decode")  # more would starve the event loop
    asyncio.get_running_loop().set_default_executor(threads)
    limits = Limits(receipt_s=settings.receipt_s, write_s=settings.write_s, queue=settings.queue)
    metrics, token = Metrics(), settings.token_text
    core: list[Service] = []
    health = Health(lambda: core[0].not_ready() if core else "It is starting.")
    service = build(settings, limits, metrics, health)
    core.append(service)
    app = make_app(service.name, service.methods, health=health, metrics=metrics, limits=limits, token=token)
    door = GrpcServer(service.methods, health=health, metrics=metrics, limits=limits, token=token)
    try:
        listener, grpc_port = _open(door, settings)
    except (OSError, RuntimeError):
        return _complain(
            f"{settings.host} must be an address of this machine, and its ports {settings.http_port} and "
            f"{settings.grpc_port} free; one could not be bound. "
            "Set FREEREIN_HOST, FREEREIN_HTTP_PORT and FREEREIN_GRPC_PORT to others, or stop what holds the ports."
        )
    cert, key = (str(path) if path else None for path in (settings.tls_cert, settings.tls_key))
    server = http.make_server(app, limits=limits, health=health, cert=cert, key=key)
    rest = asyncio.create_task(server.serve(sockets=[listener]))
    await door.server.start()
    http_port = listener.getsockname()[1]
    _log.info("listening", extra={"host": settings.host, "http_port": http_port, "grpc_port": grpc_port})
    sys.stdout.write(json.dumps({"service": service.name, "http_port": http_port, "grpc_port": grpc_port}) + "\n")
    sys.stdout.flush()
    reporter = asyncio.create_task(door.report_health())
    warm_up = asyncio.create_task(_warm_up(service, server, health))
    await health.wait_for_drain()
    _log.info("draining")
    await door.server.stop(limits.drain_s)
    await asyncio.gather(rest, reporter)
    warm_up.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await warm_up
    await service.close()
    _log.info("stopped")
    return 0


async def _warm_up(service: Service, server: http.Server, health: Health) -> None:
    try:
        await service.start()
        _log.info("ready" if not health.reason() else "open", extra={"reason": health.reason()})
    except BaseException:
        health.drain()
        server.should_exit = True
        raise


def _open(door: GrpcServer, settings: ServiceSettings) -> tuple[socket.socket, int]:
    """Returns the REST door's socket, which takes connections already, and the gRPC door's port."""
    with _bound(settings.host, settings.grpc_port):
        pass  # gRPC would say on stderr, too, that the port is taken
    listener = _bound(settings.host, settings.http_port)
    try:
        listener.listen(_BACKLOG)
        return listener, _bind(door, settings)
    except BaseException:
        listener.close()
        raise


def _bound(host: str, port: int) -> socket.socket:
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except BaseException:
        bound.close()
        raise
    return bound


def _bind(door: GrpcServer, settings: ServiceSettings) -> int:
    address = (
        f"[{settings.host}]:{settings.grpc_port}" if ":" in settings.host else f"{settings.host}:{settings.grpc_port}"
    )
    if settings.tls_cert is None or settings.tls_key is None:
        return door.server.add_insecure_port(address)
    pair = (settings.tls_key.read_bytes(), settings.tls_cert.read_bytes())
    return door.server.add_secure_port(address, grpc.ssl_server_credentials([pair]))


def _reason(error: ValidationError) -> str:
    problems = [("_".join(map(str, problem["loc"])).upper(), problem["msg"]) for problem in error.errors()]
    return "; ".join(
        f"FREEREIN_{name}: {text}" if name else text.removeprefix("Value error, ") for name, text in problems
    )


def _complain(reason: str) -> int:
    sys.stderr.write(f"cannot start: {reason}\n")
    return CONFIGURATION_ERROR
