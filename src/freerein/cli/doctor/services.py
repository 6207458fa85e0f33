"""Checks of services: running, ready, and answering a call with the token and the certificate of the environment."""

import os
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any

import grpc
import httpx

from freerein.cli.doctor.machine import CheckResult
from freerein.cli.settings import CliSettings
from freerein.clients.channel import is_loopback
from freerein.ports import PORTS, Ports, addresses
from freerein.stack.certificates import (
    certificate_file,
    certificate_problem,
    speaks_tls,
    tls_context,
    tls_problem,
)
from freerein.stack.endpoints import configured_host, configured_ports, connectable, is_free

_TIMEOUT_S = 2.0
_CALL_S = 10.0
_LISTS = {"orchestrator": "orchestrator.v1.OrchestratorService/ListRuns", "sim": "sim.v1.SimService/ListTasks"}
"""A call of each service that needs the token; learned services list their models."""


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
    if names and (problem := certificate_problem(_certificate())):
        return [lambda: CheckResult("certificate", "problem", problem, "Correct FREEREIN_TLS_CERT.")]
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
        if _certificate() is None and speaks_tls(connectable(host), ports.rest, timeout_s=_TIMEOUT_S):
            return _without_certificate(name)
        detail = f"port {held} is used by another program"
        return CheckResult(name, "problem", detail, f"Stop it; `ss -ltnp sport = :{held}` names it.")
    if not answer.is_success:
        return CheckResult(name, "warning", _reason(answer), "Wait, or read logs/<service>.log in the data directory.")
    if not _is_reachable(target):
        return CheckResult(name, "problem", f"gRPC port {ports.grpc} does not answer", "Restart `freerein up`.")
    return _check_call(name, target) or CheckResult(name, "ok", f"ready at {url}, gRPC {target}")


def _check_remote(name: str) -> CheckResult:
    targets = addresses(name, os.environ)
    for target in targets:
        if found := _check_target(name, target):
            return found
    return CheckResult(name, "ok", f"answers at {' and '.join(targets)}")


def _check_target(name: str, target: str) -> CheckResult | None:
    """Returns what is wrong with a service at a gRPC address; None where nothing is."""
    if _is_reachable(target):
        return _check_call(name, target)
    host, _, port = target.rpartition(":")
    if problem := _tls_problem(host, int(port)):
        return CheckResult(name, "problem", problem, "Set FREEREIN_TLS_CERT as the service has it.")
    if _certificate() is None and speaks_tls(host, int(port), timeout_s=_TIMEOUT_S):
        return _without_certificate(name)
    return CheckResult(name, "problem", f"no answer at {target}", f"Start it there, or correct {_variable(name)}.")


def _check_call(name: str, target: str) -> CheckResult | None:
    """Returns why a call that needs the token fails, or need not; None where it is answered as it should be."""
    token = CliSettings().token_text
    refused = _refusal(name, target, token)
    if refused is None:
        return _check_exposure(name, target, token)
    code = refused.code()
    if code is grpc.StatusCode.UNAUTHENTICATED:
        detail = "refuses the token in FREEREIN_TOKEN" if token else "needs a token, and FREEREIN_TOKEN is not set"
        return CheckResult(name, "problem", detail, "Set FREEREIN_TOKEN as the service has it.")
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return CheckResult(name, "problem", f"another service answers at {target}", f"Correct {_variable(name)}.")
    return CheckResult(name, "warning", f"a call at {target}: {refused.details()}", "Wait, or read its log.")


def _check_exposure(name: str, target: str, token: str) -> CheckResult | None:
    """Returns where a token does not protect what it is meant to; None where it does, or there is none."""
    if token and _refusal(name, target, "") is None:
        detail = f"answers at {target} without a token, too, though FREEREIN_TOKEN is set here"
        return CheckResult(name, "warning", detail, "Start it with FREEREIN_TOKEN.")
    if token and not _certificate() and not is_loopback(target):
        detail = f"answers at {target}; the token travels there without TLS"
        return CheckResult(name, "warning", detail, "Set FREEREIN_TLS_CERT and FREEREIN_TLS_KEY of the service.")
    return None


def _refusal(name: str, target: str, token: str) -> Any:
    """Returns the `grpc.RpcError` of a call with a token; None where the call succeeds."""
    path = f"/freerein.api.{_LISTS.get(name, 'learning.v1.ModelService/ListModels')}"
    metadata = (("authorization", f"Bearer {token}"),) if token else ()
    with _channel(target) as channel:
        call: Any = channel.unary_unary(path)
        try:
            call(b"", timeout=_CALL_S, metadata=metadata)
        except grpc.RpcError as error:
            return error
    return None


def _without_certificate(name: str) -> CheckResult:
    detail = "speaks TLS, and FREEREIN_TLS_CERT is not set here"
    return CheckResult(name, "problem", detail, "Set FREEREIN_TLS_CERT to the service's certificate.")


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
    certificate, options = _certificate(), [("grpc.enable_http_proxy", int(not is_loopback(target)))]
    if certificate is None:
        return grpc.insecure_channel(target, options)
    credentials = grpc.ssl_channel_credentials(certificate_file(certificate).read_bytes())
    return grpc.secure_channel(target, credentials, options)


def _certificate() -> str | None:
    return os.environ.get("FREEREIN_TLS_CERT") or None


def _scheme() -> str:
    return "https" if _certificate() else "http"
