"""Installed services, their addresses, and free ports."""

import contextlib
import errno
import socket
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import entry_points

from freerein.errors import FailedPrecondition, InvalidInput, NotFound, quoted
from freerein.ports import PORTS, Ports, address, default_ports, rest_url
from freerein.serving.environment import is_container_link, unbracketed

GROUP = "freerein.services"
LOOPBACK = "127.0.0.1"
_WILDCARDS = ("0.0.0.0", "::")  # clients cannot connect to these
_MAX_PORT = 65535


@dataclass(frozen=True)
class Endpoints:
    """REST URL and gRPC address, `host:port`, of running services."""

    urls: Mapping[str, str]
    addresses: Mapping[str, str]


def running_endpoints(names: Iterable[str], environ: Mapping[str, str]) -> Endpoints:
    """Returns where services run, as the environment says."""
    addresses = {name: address(name, environ) for name in names}
    return Endpoints({name: rest_url(name, environ) for name in addresses}, addresses)


def isolated_environ(environ: Mapping[str, str]) -> dict[str, str]:
    """Returns an environment without what would connect services to other people's."""
    places = {f"FREEREIN_{name.upper()}_{kind}" for name in PORTS for kind in ("ADDRESS", "URL")}
    shared = {"FREEREIN_DATABASE_URL", "FREEREIN_EXECUTOR_ID", *places}
    return {name: value for name, value in environ.items() if name not in shared}


def installed() -> dict[str, str]:
    """Returns the module of each installed service, for `python -m`."""
    found = {entry.name: entry.module.removesuffix(".__main__") for entry in entry_points(group=GROUP)}
    return {name: found[name] for name in PORTS if name in found}


def choose(names: Iterable[str]) -> dict[str, str]:
    """Returns the modules of the named services, by default of all; raises NotFound where one is not installed."""
    modules = installed()
    missing = [name for name in names if name not in modules]
    if missing or not modules:
        raise NotFound(
            f"Services must be installed; installed are {', '.join(modules) or 'none'}, and {len(missing)} of those "
            "requested are not.",
            hint="Correct the name, or install the service, such as `pip install -e services/sim`.",
        )
    return {name: modules[name] for name in names} or modules


def free_ports(names: Iterable[str]) -> dict[str, Ports]:
    """Returns a free REST port and a free gRPC port on loopback for each service."""
    with contextlib.ExitStack() as held:
        return {name: Ports(_free_port(held), _free_port(held)) for name in names}


def configured_ports(names: Collection[str], environ: Mapping[str, str]) -> dict[str, Ports]:
    """Returns the ports of services: the default ones, or for a single service those that the environment sets.

    `FREEREIN_PORT_BASE`, `FREEREIN_HTTP_PORT` and `FREEREIN_GRPC_PORT` are read; 0 means a free port.
    """
    ports = {name: default_ports(name, environ) for name in names}
    for attribute, variable in (("rest", "FREEREIN_HTTP_PORT"), ("grpc", "FREEREIN_GRPC_PORT")):
        value = environ.get(variable, "").strip()
        if not value or is_container_link(value):
            continue
        if len(ports) != 1:
            raise InvalidInput(
                f"{variable} sets the port of one service; got {len(ports)} services.",
                field=variable,
                hint=f"Unset {variable}, name one service, or use --port-base or --free-ports.",
            )
        if not (value.isdecimal() and int(value) <= _MAX_PORT):
            raise InvalidInput(
                f"{variable} must be a port, 0 to {_MAX_PORT}; got another value.",
                field=variable,
                hint="Set it to a number such as 8104, or to 0 for a free port.",
            )
        (name,) = ports
        port = int(value) or getattr(free_ports([name])[name], attribute)
        ports[name] = replace(ports[name], **{attribute: port})
    return ports


def configured_host(environ: Mapping[str, str]) -> str:
    """Returns the address that services bind: `FREEREIN_HOST`, by default loopback."""
    return unbracketed(environ.get("FREEREIN_HOST") or "") or LOOPBACK


def connectable(host: str) -> str:
    """Returns where clients of this machine connect to a service that binds a host, as part of a URL."""
    reachable = LOOPBACK if host in _WILDCARDS else host
    return f"[{reachable}]" if ":" in reachable else reachable


def hold(ports: Mapping[str, Ports], *, host: str = LOOPBACK) -> contextlib.ExitStack:
    """Binds the ports of services until the result is closed, so that no other program is given one of them.

    The services bind them all the same, by SO_REUSEADDR, since nobody listens here. Raises FailedPrecondition where a
    port cannot be bound.
    """
    with contextlib.ExitStack() as held:
        for service, pair in ports.items():
            for port in (pair.rest, pair.grpc):
                try:
                    held.enter_context(_bound(port, host))
                except OSError as error:
                    raise _not_bound(error, service, port, host) from None
        return held.pop_all()


def _not_bound(error: OSError, service: str, port: int, host: str) -> FailedPrecondition:
    if error.errno == errno.EADDRINUSE:
        return FailedPrecondition(
            f"Port {port} must be free for {service}; it is in use.",
            hint="Stop the other `freerein up` or whatever uses the port; `freerein doctor` says more.",
        )
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return FailedPrecondition(
            f"FREEREIN_HOST must be an address of this machine; got {quoted(host)}.",
            field="FREEREIN_HOST",
            hint="`ip address` lists them; 0.0.0.0 stands for all.",
        )
    return FailedPrecondition(f"Port {port} of {host} must be one that {service} may bind; {error.strerror}.")


def is_free(port: int, *, host: str = LOOPBACK) -> bool:
    """Returns whether a port can be bound."""
    try:
        _bound(port, host).close()
    except OSError:
        return False
    return True


def _bound(port: int, host: str) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    candidate = socket.socket(family, socket.SOCK_STREAM)
    candidate.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        candidate.bind((host, port))
    except OSError:
        candidate.close()
        raise
    return candidate


def _free_port(held: contextlib.ExitStack) -> int:
    listener = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
    listener.bind((LOOPBACK, 0))
    return int(listener.getsockname()[1])
