"""Web pages of the origins that an operator names may call the REST API, and no others."""

import httpx
import pytest
from pydantic import ValidationError

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


def test_origins_are_separated_by_commas() -> None:
    assert ServiceSettings(cors_origins=f"{OURS}, {OTHER}").origins == (OURS, OTHER)
    assert ServiceSettings().origins == ()


@pytest.mark.parametrize("wrong", ["*", "localhost:3000", "http://a.example/path", "http://*.example"])
def test_what_is_no_origin_is_refused(wrong: str) -> None:
    with pytest.raises(ValidationError, match="FREEREIN_CORS_ORIGINS"):
        ServiceSettings(cors_origins=wrong)
