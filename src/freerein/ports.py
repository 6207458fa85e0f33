"""Default ports of the services, and the environment variables that override their addresses."""

from collections.abc import Mapping
from dataclasses import dataclass

from freerein.errors import InvalidInput


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


def address(service: str, environ: Mapping[str, str]) -> str:
    """Returns the first of a service's gRPC addresses; see `addresses`."""
    return addresses(service, environ)[0]


def addresses(service: str, environ: Mapping[str, str]) -> tuple[str, ...]:
    """Returns the gRPC addresses, `host:port`, of all replicas of a service.

    They are the comma-separated value of `FREEREIN_<SERVICE>_ADDRESS`, by default loopback and the port table. Raises
    InvalidInput when the service does not exist, or the variable does not hold `host:port`.
    """
    if service not in PORTS:
        raise InvalidInput(
            f"The service must be one of {', '.join(PORTS)}; got another name.",
            field="service",
            hint="Use one of these names.",
        )
    variable = f"FREEREIN_{service.upper()}_ADDRESS"
    found = (environ.get(variable) or f"127.0.0.1:{PORTS[service].grpc}").split(",")
    for each in found:
        host, _, port = each.rpartition(":")
        if not (host and port.isdecimal()):
            raise InvalidInput(
                f"{variable} must hold host:port; got something else.",
                field=variable,
                hint=f"Set it to something like 127.0.0.1:{PORTS[service].grpc}, or unset it.",
            )
    return tuple(found)
