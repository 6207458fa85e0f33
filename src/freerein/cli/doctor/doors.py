"""Whether each service runs and is ready; where it does not run, whether it could have its ports."""

import os
from pathlib import Path

import grpc
import httpx

from freerein.cli.doctor.finding import Finding
from freerein.cli.services import LOOPBACK, is_free, trust
from freerein.ports import PORTS, address, addresses

_TIMEOUT_S = 2.0


def service(name: str) -> Finding:
    """Finds out how a service stands that is to run on this machine, or on the one that its address names."""
    ports = PORTS[name]
    if os.environ.get(f"FREEREIN_{name.upper()}_ADDRESS"):
        return _far(name)
    held = [port for port in (ports.rest, ports.grpc) if not is_free(port)]
    if not held:
        detail = f"does not run; ports {ports.rest} and {ports.grpc} are free"
        return Finding(name, "warning", detail, "Run `freerein up`.")
    answer = _ask(ports.rest)
    if answer is None:
        detail = f"port {' and '.join(map(str, held))} is held by another program"
        return Finding(name, "problem", detail, f"Stop it; `ss -ltnp sport = :{held[0]}` names it.")
    if not answer.is_success:
        return Finding(name, "warning", _reason(answer), "Wait, or read logs/<service>.log in the data directory.")
    if not _is_reachable(address(name, os.environ)):
        return Finding(name, "problem", f"gRPC port {ports.grpc} does not answer", "Stop `freerein up`, start it anew.")
    return Finding(name, "ok", f"ready at {_scheme()}://{LOOPBACK}:{ports.rest}, gRPC {LOOPBACK}:{ports.grpc}")


def _far(name: str) -> Finding:
    targets, variable = addresses(name, os.environ), f"FREEREIN_{name.upper()}_ADDRESS"
    for target in targets:
        if not _is_reachable(target):
            return Finding(name, "problem", f"does not answer at {target}", f"Start it there, or mend {variable}.")
    return Finding(name, "ok", f"answers at {' and '.join(targets)}")


def _ask(port: int) -> httpx.Response | None:
    """Returns what a service of ours says of its readiness; None where no such service listens."""
    url = f"{_scheme()}://{LOOPBACK}:{port}"
    with httpx.Client(timeout=_TIMEOUT_S, trust_env=False, verify=trust(_certificate())) as client:
        try:
            live = client.get(f"{url}/healthz")
            return client.get(f"{url}/readyz") if live.json() == {"live": True} else None
        except (httpx.HTTPError, ValueError):
            return None


def _reason(answer: httpx.Response) -> str:
    try:
        return str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"is not ready: HTTP {answer.status_code}"


def _is_reachable(target: str) -> bool:
    with _channel(target) as channel:
        try:
            grpc.channel_ready_future(channel).result(_TIMEOUT_S)
        except grpc.FutureTimeoutError:
            return False
        return True


def _channel(target: str) -> grpc.Channel:
    certificate = _certificate()
    if certificate is None:
        return grpc.insecure_channel(target)
    return grpc.secure_channel(target, grpc.ssl_channel_credentials(Path(certificate).read_bytes()))


def _certificate() -> str | None:
    return os.environ.get("FREEREIN_TLS_CERT") or None


def _scheme() -> str:
    return "https" if _certificate() else "http"
