"""TLS: a client speaks only to a service whose certificate is valid, for its name, and from whom it trusts."""

import ssl
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest
import trustme

from freerein.clients import Channel, SimClient
from freerein.errors import Unavailable
from freerein.types.sim import ListTasksRequest

pytestmark = [pytest.mark.e2e, pytest.mark.fault("N3")]
AUTHORITY = trustme.CA()


@pytest.fixture(scope="module")
def start(start_module_service: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """A function that starts a service with a certificate."""

    def start_with(certificate: trustme.LeafCert) -> Any:
        folder = tmp_path_factory.mktemp("tls")
        chain, key = folder / "chain.pem", folder / "key.pem"
        chain.write_bytes(b"".join(part.bytes() for part in certificate.cert_chain_pems))
        key.write_bytes(certificate.private_key_pem.bytes())
        environ = {"FREEREIN_TLS_CERT": str(chain), "FREEREIN_TLS_KEY": str(key), "FREEREIN_SIM_WORKERS": "1"}
        return start_module_service("freerein_sim", **environ)

    return start_with


@pytest.fixture(scope="module")
def service(start: Callable[..., Any], wait_until: Any) -> Any:
    service = start(AUTHORITY.issue_cert("127.0.0.1"))
    wait_until(lambda: get(service, AUTHORITY, "readyz") == 200, 300)
    return service


def get(service: Any, authority: trustme.CA, path: str = "healthz") -> int:
    """Returns the status of a GET over REST."""
    trusted = ssl.create_default_context(cadata=authority.cert_pem.bytes().decode())
    with httpx.Client(verify=trusted, timeout=60, trust_env=False) as client:
        return client.get(f"{service.url.replace('http', 'https')}/{path}").status_code


async def call(service: Any, authority: trustme.CA | None) -> None:
    """Makes a call over gRPC."""
    roots = authority.cert_pem.bytes() if authority else None
    async with SimClient(Channel(service.address, root_certificates=roots)) as client:
        await client.list_tasks(ListTasksRequest(), timeout_s=60)


async def test_who_trusts_the_authority_is_answered(service: Any) -> None:
    assert get(service, AUTHORITY) == 200
    await call(service, AUTHORITY)


async def test_who_trusts_another_authority_speaks_to_nobody(service: Any) -> None:
    with pytest.raises(httpx.ConnectError, match="local issuer"):
        get(service, trustme.CA())
    with pytest.raises(Unavailable, match="local issuer"):
        await call(service, trustme.CA())


def test_plain_text_is_refused_over_rest(service: Any) -> None:
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{service.url}/healthz", timeout=60, trust_env=False)


async def test_plain_text_is_refused_over_grpc(service: Any) -> None:
    with pytest.raises(Unavailable, match="Socket closed"):
        await call(service, None)


@pytest.mark.parametrize(
    ("certificate", "reason"),
    [
        (AUTHORITY.issue_cert("127.0.0.1", not_after=datetime(2020, 1, 1, tzinfo=UTC)), "expired"),
        (AUTHORITY.issue_cert("elsewhere"), "mismatch|Hostname"),
    ],
    ids=["expired", "of another name"],
)
async def test_a_certificate_that_is_not_valid_ends_the_handshake(
    start: Callable[..., Any], certificate: trustme.LeafCert, reason: str
) -> None:
    service = start(certificate)
    with pytest.raises(httpx.ConnectError, match=reason):
        get(service, AUTHORITY)
    with pytest.raises(Unavailable, match=reason):
        await call(service, AUTHORITY)
