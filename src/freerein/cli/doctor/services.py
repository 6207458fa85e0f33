"""Checks of services: running and ready, or their ports free."""

import os
from collections.abc import Collection
from pathlib import Path

import grpc
import httpx

from freerein.cli.doctor.machine import CheckResult
from freerein.cli.services.endpoints import LOOPBACK, is_free, tls_context
from freerein.ports import PORTS, address, addresses

_TIMEOUT_S = 2.0


def expected(installed: Collection[str]) -> list[str]:
    """Returns the services that should answer: those that are installed, and those that the environment says where."""
    return [name for name in PORTS if name in installed or os.environ.get(_variable(name))]


def check_service(name: str) -> CheckResult:
    """Checks a service on this machine, or at its address in the environment."""
    ports = PORTS[name]
    if os.environ.get(_variable(name)):
        return _check_remote(name)
    held = [port for port in (ports.rest, ports.grpc) if not is_free(port)]
    if not held:
        detail = f"not running; ports {ports.rest} and {ports.grpc} are free"
        return CheckResult(name, "warning", detail, "Run `freerein up`.")
    answer = _ask(ports.rest)
    if answer is None:
        detail = f"port {' and '.join(map(str, held))} is used by another program"
        return CheckResult(name, "problem", detail, f"Stop it; `ss -ltnp sport = :{held[0]}` names it.")
    if not answer.is_success:
        return CheckResult(name, "warning", _reason(answer), "Wait, or read logs/<service>.log in the data directory.")
    if not _is_reachable(address(name, os.environ)):
        return CheckResult(name, "problem", f"gRPC port {ports.grpc} does not answer", "Restart `freerein up`.")
    return CheckResult(name, "ok", f"ready at {_scheme()}://{LOOPBACK}:{ports.rest}, gRPC {LOOPBACK}:{ports.grpc}")


def _check_remote(name: str) -> CheckResult:
    targets = addresses(name, os.environ)
    for target in targets:
        if not _is_reachable(target):
            fix = f"Start it there, or correct {_variable(name)}."
            return CheckResult(name, "problem", f"no answer at {target}", fix)
    return CheckResult(name, "ok", f"answers at {' and '.join(targets)}")


def _variable(name: str) -> str:
    return f"FREEREIN_{name.upper()}_ADDRESS"


def _ask(port: int) -> httpx.Response | None:
    """Returns the readiness reply; None where no freerein service listens."""
    url = f"{_scheme()}://{LOOPBACK}:{port}"
    with httpx.Client(timeout=_TIMEOUT_S, trust_env=False, verify=tls_context(_certificate())) as client:
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
