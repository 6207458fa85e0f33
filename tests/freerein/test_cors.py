"""Web pages of the service itself and of the origins that an operator names may call the REST API, and no others."""

import httpx
import pytest
from pydantic import SecretStr, ValidationError

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.settings import ServiceSettings

OURS, OTHER = "http://localhost:3000", "http://elsewhere.example"


async def preflight(allowed: tuple[str, ...], origin: str) -> httpx.Response:
    app = make_app("toy", [], health=Health(), metrics=Metrics(), limits=Limits(), token="secret", origins=allowed)
    asked = {
        "origin": origin,
        "access-control-request-method": "POST",
        "access-control-request-headers": "authorization",
    }
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://toy") as client:
        return await client.options("/v1/anything", headers=asked)


async def test_a_page_of_a_named_origin_may_call() -> None:
    reply = await preflight((OURS,), OURS)
    assert (reply.status_code, reply.headers["access-control-allow-origin"]) == (200, OURS)
    assert "authorization" in reply.headers["access-control-allow-headers"].lower()


@pytest.mark.parametrize(("allowed", "origin"), [((), OURS), ((OURS,), OTHER)])
async def test_no_other_page_may(allowed: tuple[str, ...], origin: str) -> None:
    reply = await preflight(allowed, origin)
    assert reply.status_code >= 400
    assert "access-control-allow-origin" not in reply.headers


async def answer(headers: dict[str, str], *, origins: tuple[str, ...] = (), is_local: bool = True) -> httpx.Response:
    """Returns the reply to a form, which a page may send without asking first: 404 where it is not refused."""
    app = make_app("toy", [], health=Health(), metrics=Metrics(), limits=Limits(), origins=origins, is_local=is_local)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost:8100") as client:
        return await client.post("/v1/anything", headers=headers, files={"text": (None, "a")})


@pytest.mark.fault("C26")
@pytest.mark.parametrize(
    "headers",
    [
        {"origin": OTHER},
        {"origin": "null"},
        {"origin": "http://localhost:8101"},
        {"origin": "http://localhost:8100.elsewhere.example"},
        {"host": "elsewhere.example:8100", "origin": "http://elsewhere.example:8100"},
        {"host": "elsewhere.example:8100"},
        {"host": "127.0.0.1.elsewhere.example"},
        {"host": "evillocalhost:8100", "origin": "http://evillocalhost:8100"},
        {"host": "localhost.elsewhere.example"},
        {"host": "[::1"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "same-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"},
    ],
)
async def test_a_page_of_another_origin_or_by_another_name_of_the_service_is_refused(headers: dict[str, str]) -> None:
    reply = await answer(headers)
    assert (reply.status_code, reply.json()["code"]) == (403, "permission_denied")
    assert reply.json()["hint"]


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"origin": OURS},
        {"origin": "http://localhost:8100"},
        {"host": "LOCALHOST:8100", "origin": "http://localhost:8100"},
        {"host": "127.0.0.1", "origin": "http://127.0.0.1"},
        {"host": "[::1]:8100", "origin": "https://[::1]:8100"},
        {"host": "freerein.localhost.:443", "origin": "https://freerein.localhost."},
        {"sec-fetch-site": "same-origin", "sec-fetch-mode": "cors"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},
        {"sec-fetch-site": "same-site", "origin": OURS},
    ],
)
async def test_a_client_and_a_page_of_the_service_itself_may_call(headers: dict[str, str]) -> None:
    assert (await answer(headers, origins=(OURS,))).status_code == 404


async def test_a_service_that_is_not_for_this_machine_only_has_any_name() -> None:
    assert (await answer({"host": "sim:8104", "origin": "http://sim:8104"}, is_local=False)).status_code == 404


def test_a_service_on_loopback_without_a_token_is_for_this_machine_only() -> None:
    assert ServiceSettings().is_local
    assert not ServiceSettings(token=SecretStr("x")).is_local
    assert not ServiceSettings(host="0.0.0.0", insecure=True).is_local


def test_origins_are_separated_by_commas() -> None:
    assert ServiceSettings(cors_origins=f"{OURS}, {OTHER}").origins == (OURS, OTHER)
    assert ServiceSettings().origins == ()


@pytest.mark.parametrize("wrong", ["*", "localhost:3000", "http://a.example/path", "http://*.example"])
def test_what_is_no_origin_is_refused(wrong: str) -> None:
    with pytest.raises(ValidationError, match="FREEREIN_CORS_ORIGINS"):
        ServiceSettings(cors_origins=wrong)
