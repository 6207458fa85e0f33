"""The page of the REST API opens without internet."""

import re
from collections.abc import AsyncIterator

import httpx
import pytest

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    app = make_app("toy", [], health=Health(), metrics=Metrics(), limits=Limits())
    async with httpx.AsyncClient(
        transport=httpx.ASGITransport(app), base_url="http://toy", follow_redirects=True
    ) as opened:
        yield opened


async def test_the_root_leads_to_the_page(client: httpx.AsyncClient) -> None:
    assert (await client.get("/")).url.path == "/docs"


async def test_the_page_needs_nothing_from_elsewhere(client: httpx.AsyncClient) -> None:
    page = (await client.get("/docs")).text
    needed = re.findall(r"(?:href|src)=\"([^\"]+)\"", page) + re.findall(r"url: '([^']+)'", page)
    assert {name.rpartition("/")[2] for name in needed} >= {"swagger-ui-bundle.js", "swagger-ui.css", "openapi.json"}
    for name in needed:
        assert "//" not in name
        reply = await client.get(f"/{name}")
        assert reply.status_code == 200
        assert len(reply.content) > 100
