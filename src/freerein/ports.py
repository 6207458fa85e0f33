"""Default ports of the services, and the environment variables that move them or override their addresses."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from freerein.errors import InvalidInput, quoted

_MAX_PORT = 65535
_HOST = re.compile(r"[^\s/:@?#\[\]]+|\[[0-9a-fA-F:.%\w]+\]")
_URL = re.compile(rf"https?://({_HOST.pattern}):(?P<port>[0-9]{{1,5}})")


@dataclass(frozen=True)
class Ports:
    """The default ports of one service."""

    rest: int
    grpc: int


PORTS = {
    "orchestrator": Ports(8100, 9100),
    "segmentation": Ports(8101, 9101),
    "imitation": Ports(8102, 9102),
    "reward": Ports(8103, 9103),
    "sim": Ports(8104, 9104),
}


PORT_BASE = "FREEREIN_PORT_BASE"
"""Variable of the port that the others follow: REST from it on, gRPC from 1000 above it on, in the order of `PORTS`."""

_FIRST = PORTS["orchestrator"].rest
MAX_PORT_BASE = _MAX_PORT - (PORTS["sim"].grpc - _FIRST)


def moved(service: str, base: int) -> Ports:
    """Returns the default ports of a service where those of all begin at `base`."""
    return Ports(PORTS[service].rest + base - _FIRST, PORTS[service].grpc + base - _FIRST)


def default_ports(service: str, environ: Mapping[str, str]) -> Ports:
    """Returns the default ports of a service, moved by `FREEREIN_PORT_BASE`; InvalidInput where that is no port."""
    base = environ.get(PORT_BASE, "").strip() or str(_FIRST)
    if not (base.isascii() and base.isdecimal() and 0 < int(base[:6]) <= MAX_PORT_BASE):
        raise InvalidInput(
            f"{PORT_BASE} must be a port from 1 to {MAX_PORT_BASE}, since others follow it; got something else.",
            field=PORT_BASE,
            hint=f"Set it to a number such as 18100, or leave it out for {_FIRST}.",
        )
    return moved(service, int(base))


def address(service: str, environ: Mapping[str, str]) -> str:
    """Returns the first of a service's gRPC addresses; see `addresses`."""
    return addresses(service, environ)[0]


def addresses(service: str, environ: Mapping[str, str]) -> tuple[str, ...]:
    """Returns the gRPC addresses, `host:port`, of all replicas of a service.

    They are the comma-separated value of `FREEREIN_<SERVICE>_ADDRESS`, by default loopback and the default port. Raises
    InvalidInput when the service does not exist, or the variable does not hold `host:port`. An IPv6 address is in
    brackets.
    """
    if service not in PORTS:
        raise InvalidInput(
            f"The service must be one of {', '.join(PORTS)}; got {quoted(service)}.",
            field="service",
            hint="Use one of these names.",
        )
    variable = f"FREEREIN_{service.upper()}_ADDRESS"
    found = [each.strip() for each in environ.get(variable, "").split(",") if each.strip()]
    for each in found:
        host, _, port = each.rpartition(":")
        is_port = port.isascii() and port.isdecimal() and 0 < int(port[:6]) <= _MAX_PORT
        if not is_port or _HOST.fullmatch(host) is None:
            raise InvalidInput(
                f"{variable} must hold host:port, with a port from 1 to {_MAX_PORT}; got something else.",
                field=variable,
                hint=f"Set it to something like 127.0.0.1:{PORTS[service].grpc} or [::1]:{PORTS[service].grpc}, "
                "without http://, or unset it.",
            )
    return tuple(found) or (f"127.0.0.1:{default_ports(service, environ).grpc}",)


def rest_url(service: str, environ: Mapping[str, str]) -> str:
    """Returns the URL of a service's REST API, such as `http://127.0.0.1:8104`.

    It is the value of `FREEREIN_<SERVICE>_URL`, by default the host of the service's first gRPC address, and the
    default port; `https` where `FREEREIN_TLS_CERT` is set. Raises InvalidInput as `addresses`, and where the variable
    does not hold such a URL.
    """
    host, variable = address(service, environ).rpartition(":")[0], f"FREEREIN_{service.upper()}_URL"
    scheme = "https" if environ.get("FREEREIN_TLS_CERT") else "http"
    default = f"{scheme}://{host}:{default_ports(service, environ).rest}"
    url = environ.get(variable, "").strip().removesuffix("/") or default
    parts = _URL.fullmatch(url)
    if parts is None or not 0 < int(parts["port"]) <= _MAX_PORT:
        raise InvalidInput(
            f"{variable} must hold http:// or https://, a host and a port, and no path; got something else.",
            field=variable,
            hint=f"Set it to something like http://127.0.0.1:{PORTS[service].rest}, or unset it.",
        )
    return url
