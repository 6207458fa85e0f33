"""Certificates of services: whom probes trust, and why a TLS handshake fails."""

import contextlib
import socket
import ssl
from pathlib import Path
from typing import Any

from freerein.serving.environment import expanded

_WRONG_NAME = (62, 64)  # X509_V_ERR_HOSTNAME_MISMATCH and X509_V_ERR_IP_ADDRESS_MISMATCH of OpenSSL
_SET_IT = "FREEREIN_TLS_CERT must hold the service's certificate"


def certificate_file(value: str) -> Path:
    """Returns the path in FREEREIN_TLS_CERT."""
    return expanded(value)


def tls_context(certificate: str | None) -> ssl.SSLContext | bool:
    """Returns the TLS verification of probes: only the given certificate, for any host name; the default for None.

    A certificate is trusted for itself, whether or not the authority that issued it is in the file.
    """
    return True if certificate is None else _trusting(certificate)


def certificate_problem(certificate: str | None) -> str:
    """Returns why the file in FREEREIN_TLS_CERT cannot be trusted at all; empty where it can, or there is none."""
    try:
        tls_context(certificate)
    except OSError as error:
        return f"FREEREIN_TLS_CERT must be a PEM file that can be read: {getattr(error, 'reason', error.strerror)}"
    return ""


def tls_problem(host: str, port: int, certificate: str, *, called: str = "", timeout_s: float) -> str:
    """Returns why clients cannot speak TLS with a service, as sentences; empty where they can, or nobody listens.

    They trust the PEM file `certificate`, and call the host `called`, if that is another. `timeout_s` is the longest
    wait for each part of a handshake.
    """
    address, name = (host.strip("[]"), port), called.strip("[]") or host.strip("[]")
    try:
        _handshake(address, certificate, name=name, timeout_s=timeout_s)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code not in _WRONG_NAME:
            return f"Its certificate is not trusted: {error.verify_message}. {_SET_IT}, or that of its authority."
        names = _names(address, certificate, timeout_s=timeout_s)
        return "" if name in names else _wrong_name(name, names)
    except ssl.SSLError as error:
        return (
            f"Its TLS handshake fails: {error.reason or 'it ends early'}. Does it speak TLS? {_SET_IT} on both sides."
        )
    except OSError:
        return ""
    return ""


def speaks_tls(host: str, port: int, *, timeout_s: float) -> bool:
    """Returns whether a TLS handshake with whom a port belongs to succeeds, whoever that is."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.set_alpn_protocols(["h2", "http/1.1"])
    try:
        with (
            socket.create_connection((host.strip("[]"), port), timeout_s) as plain,
            context.wrap_socket(plain),
        ):
            return True
    except OSError:
        return False


def _trusting(certificate: str) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=certificate_file(certificate))
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def _handshake(address: tuple[str, int], certificate: str, *, name: str | None, timeout_s: float) -> dict[str, Any]:
    """Returns the certificate of a peer that is trusted, for a name unless that is None."""
    context = _trusting(certificate)
    context.check_hostname = name is not None
    context.set_alpn_protocols(["h2", "http/1.1"])
    with (
        socket.create_connection(address, timeout_s) as plain,
        context.wrap_socket(plain, server_hostname=name) as secure,
    ):
        return secure.getpeercert() or {}


def _names(address: tuple[str, int], certificate: str, *, timeout_s: float) -> list[str]:
    """Returns the hosts that a peer's certificate names, or where it names none, its subject."""
    peer: dict[str, Any] = {}
    with contextlib.suppress(OSError):
        peer = _handshake(address, certificate, name=None, timeout_s=timeout_s)
    names = [name for kind, name in peer.get("subjectAltName", ()) if kind in ("DNS", "IP Address")]
    return names or [value for part in peer.get("subject", ()) for key, value in part if key == "commonName"]


def _wrong_name(host: str, names: list[str]) -> str:
    return (
        f"Its certificate is for {', '.join(names) or 'no host'}; it is called at {host}. Bind one of these names "
        f"(FREEREIN_HOST), or have the certificate name {host}, too."
    )
