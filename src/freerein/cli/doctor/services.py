"""Checks of services: running and ready, or their ports free."""

import os
from collections.abc import Callable, Collection, Sequence
from functools import partial

import grpc
import httpx

from freerein.cli.doctor.machine import CheckResult
from freerein.cli.services.certificates import certificate_file, tls_context, tls_problem
from freerein.cli.services.endpoints import configured_host, configured_ports, connectable, is_free
from freerein.ports import PORTS, Ports, addresses

_TIMEOUT_S = 2.0


def expected(installed: Collection[str], chosen: Collection[str]) -> list[str]:
    """Returns the services to look at: those chosen, else those installed or with an address in the environment.

    Raises InvalidInput when one that is chosen does not exist.
    """
    for name in chosen:
        addresses(name, os.environ)
    return [name for name in PORTS if name in (chosen or installed) or (not chosen and os.environ.get(_variable(name)))]


def checks(names: Sequence[str]) -> list[Callable[[], CheckResult]]:
    """Returns a check of each service: at its address in the environment, else at its configured ports here.

    Raises InvalidInput when the environment sets the port of one service, and several are here.
    """
    away = [name for name in names if os.environ.get(_variable(name))]
    here = [name for name in names if name not in away]
    ports = configured_ports(here, os.environ) if here else {}
    remote = (partial(_check_remote, name) for name in away)
    return [*remote, *(partial(_check_local, name, pair) for name, pair in ports.items())]


def _check_local(name: str, ports: Ports) -> CheckResult:
    host = configured_host(os.environ)
    if not is_free(0, host=host):
        return CheckResult(name, "problem", f"{host} is no address of this machine", "Correct FREEREIN_HOST.")
    held = [port for port in (ports.rest, ports.grpc) if not is_free(port, host=host)]
    if not held:
        detail = f"not running; ports {ports.rest} and {ports.grpc} are free"
        return CheckResult(name, "warning", detail, "Run `freerein up`.")
    return _check_running(name, host, ports, held=held[0])


def _check_running(name: str, host: str, ports: Ports, *, held: int) -> CheckResult:
    """Checks the program that holds a port of a service."""
    url, target = f"{_scheme()}://{connectable(host)}:{ports.rest}", f"{connectable(host)}:{ports.grpc}"
    if problem := _tls_problem(connectable(host), ports.rest):
        return CheckResult(name, "problem", problem, "Set FREEREIN_TLS_CERT as the service has it.")
    answer = _ask(url)
    if answer is None:
        detail = f"port {held} is used by another program"
        return CheckResult(name, "problem", detail, f"Stop it; `ss -ltnp sport = :{held}` names it.")
    if not answer.is_success:
        return CheckResult(name, "warning", _reason(answer), "Wait, or read logs/<service>.log in the data directory.")
    if not _is_reachable(target):
        return CheckResult(name, "problem", f"gRPC port {ports.grpc} does not answer", "Restart `freerein up`.")
    return CheckResult(name, "ok", f"ready at {url}, gRPC {target}")


def _check_remote(name: str) -> CheckResult:
    targets = addresses(name, os.environ)
    for target in targets:
        if not _is_reachable(target):
            where, _, port = target.rpartition(":")
            if problem := _tls_problem(where, int(port)):
                return CheckResult(name, "problem", problem, "Set FREEREIN_TLS_CERT as the service has it.")
            fix = f"Start it there, or correct {_variable(name)}."
            return CheckResult(name, "problem", f"no answer at {target}", fix)
    return CheckResult(name, "ok", f"answers at {' and '.join(targets)}")


def _variable(name: str) -> str:
    return f"FREEREIN_{name.upper()}_ADDRESS"


def _ask(url: str) -> httpx.Response | None:
    """Returns the readiness reply; None where no freerein service listens."""
    with httpx.Client(timeout=_TIMEOUT_S, trust_env=False, verify=tls_context(_certificate())) as client:
        try:
            live = client.get(f"{url}/healthz")
            return client.get(f"{url}/readyz") if live.json() == {"live": True} else None
        except (httpx.HTTPError, ValueError):
            return None


def _tls_problem(host: str, port: int) -> str:
    certificate = _certificate()
    return tls_problem(host, port, certificate, timeout_s=_TIMEOUT_S) if certificate else ""


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
    return grpc.secure_channel(target, grpc.ssl_channel_credentials(certificate_file(certificate).read_bytes()))


def _certificate() -> str | None:
    return os.environ.get("FREEREIN_TLS_CERT") or None


def _scheme() -> str:
    return "https" if _certificate() else "http"
