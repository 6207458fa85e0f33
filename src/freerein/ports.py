"""Where services are found: one table of default ports, and the environment that overrides it."""

from collections.abc import Mapping
from dataclasses import dataclass

from freerein.errors import InvalidInput


@dataclass(frozen=True)
class Ports:
    """The default ports of one service.

    Attributes:
        rest: Of its REST door.
        grpc: Of its gRPC door.
    """

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
    """Returns the gRPC address, `host:port`, of a service: `FREEREIN_<SERVICE>_ADDRESS`, or loopback and its port.

    Args:
        service: A key of `PORTS`.
        environ: The environment, such as `os.environ`.

    Raises:
        InvalidInput: There is no such service, or the variable does not hold `host:port`.
    """
    return addresses(service, environ)[0]


def addresses(service: str, environ: Mapping[str, str]) -> tuple[str, ...]:
    """Returns the gRPC addresses of all replicas of a service; the variable may hold several, with commas between.

    Args:
        service: A key of `PORTS`.
        environ: The environment, such as `os.environ`.

    Raises:
        InvalidInput: There is no such service, or the variable does not hold `host:port`.
    """
    if service not in PORTS:
        raise InvalidInput(
            f"The service must be one of {', '.join(PORTS)}; got another name.",
            field="service",
            hint="Name the service whose address you want.",
        )
    variable = f"FREEREIN_{service.upper()}_ADDRESS"
    found = (environ.get(variable) or f"127.0.0.1:{PORTS[service].grpc}").split(",")
    for each in found:
        host, _, port = each.rpartition(":")
        if not (host and port.isdecimal()):
            raise InvalidInput(
                f"{variable} must hold host:port; got no such pair.",
                field=variable,
                hint=f"Set it to something like 127.0.0.1:{PORTS[service].grpc}, or unset it.",
            )
    return tuple(found)
