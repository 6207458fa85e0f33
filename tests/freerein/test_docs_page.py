"""The page of the REST API opens without internet and without the token, and describes what there is."""

import re
from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest

from freerein.api.imitation.v1 import imitation_pb2
from freerein.api.learning.v1 import learning_pb2
from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.methods import methods_of
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein_imitation.methods import METHODS


class EveryMethod:
    """A core that has every method."""

    def __getattr__(self, name: str) -> object:
        return name


async def _refuse(_query: object) -> Any:
    raise AssertionError


def app(**options: Any) -> Any:
    services = (
        imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"],
        learning_pb2.DESCRIPTOR.services_by_name["FitService"],
    )
    methods = [method for service in services for method in methods_of(service, EveryMethod())]
    return make_app("imitation", methods, health=Health(), metrics=Metrics(), limits=Limits(), **options)


async def document(url: str = "http://toy:18102", headers: dict[str, str] | None = None, **options: Any) -> Any:
    transport = httpx.ASGITransport(app(**options))
    async with httpx.AsyncClient(transport=transport, base_url=url) as client:
        return (await client.get("/openapi.json", headers=headers)).json()


def operations(described: Any) -> dict[str, Any]:
    return {each["operationId"]: each for path in described["paths"].values() for each in path.values()}


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(app(token="secret"))
    async with httpx.AsyncClient(transport=transport, base_url="http://toy", follow_redirects=True) as opened:
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


async def test_every_operation_is_described_and_so_are_the_streams_that_rest_does_not_have() -> None:
    described = await document(open_websocket=_refuse)
    assert described["servers"] == [{"url": "/"}]
    about = described["info"]["description"]
    assert all(f"**{part}" in about for part in ("Event streams.** `GET /v1/watch-fit`", "WebSocket.** At `/`"))
    assert "- `Control`: A stream for a robot's control loop" in about
    assert "WebSocket" not in (await document())["info"]["description"]
    for name, each in operations(described).items():
        assert 5 < len(each["summary"]) < 120, name
        assert each["summary"] in each["description"]
        assert "```sh\ncurl " in each["description"]
    watch = operations(described)["WatchFit"]["description"]
    assert all(
        part in watch for part in ("server-sent events", "`Last-Event-ID`", "curl -N 'http://toy:18102/v1/watch")
    )


@pytest.mark.parametrize(
    ("url", "headers", "called"),
    [
        ("http://127.0.0.1:18102", {}, "http://127.0.0.1:18102/v1/"),
        ("https://[::1]:18102", {}, "https://[::1]:18102/v1/"),
        ("http://robots.example", {}, "http://robots.example/v1/"),
        ("http://toy:18102", {"host": "toy`$(rm -r x)`"}, "http://toy:18102/v1/"),
    ],
)
async def test_commands_call_what_the_caller_has_called(url: str, headers: dict[str, str], called: str) -> None:
    described = await document(url, headers)
    for name, each in operations(described).items():
        assert called in each["description"], name
        assert "$(" not in each["description"]


async def test_commands_carry_the_token_where_one_is_needed_and_nothing_shows_it() -> None:
    described = await document(token="s3cr3t")
    assert described["security"] == [{"token": []}]
    assert "s3cr3t" not in str(described)
    for each in operations(described).values():
        assert 'curl -H "Authorization: Bearer $FREEREIN_TOKEN" ' in each["description"].replace(" -N", "")
    assert (await document())["security"] == [{}, {"token": []}]


async def test_the_configuration_of_a_fit_is_described_for_each_method() -> None:
    described = await document(configs=lambda: {"StartFitRequest": METHODS.schema()})
    config = described["components"]["schemas"]["StartFitRequest"]["properties"]["config"]
    assert [each["title"] for each in config["anyOf"]] == list(METHODS.by_name)
    first, second = config["anyOf"][:2]
    assert first["properties"]["lr"] == {
        "type": "number",
        "minimum": 1e-7,
        "maximum": 1.0,
        "default": 0.006,
        "description": "Peak learning rate of Adam: linear warm-up over `warmup_steps`, then cosine decay to zero.",
    }
    assert (first["required"], second["required"]) == ([], ["method"])
    assert second["properties"]["method"] == {"const": "goal_cloning"}


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("/v1/act/", "`/v1/act/`; did you mean `/v1/act`?"),
        ("/start_fit", "`/start_fit`; did you mean `/v1/start-fit`?"),
        ("/v1/GetFit", "`/v1/GetFit`; did you mean `/v1/get-fit`?"),
        ("/health", "`/health`; did you mean `/healthz`?"),
        ("/openapi", "`/openapi`; did you mean `/openapi.json`?"),
        ("/v1/step", "`/v1/step`, which is one of the sim service."),
        ("/v1/control", "`/v1/control`, which is one of the imitation service, over gRPC alone."),
        ("/nothing/like/it", "`/nothing/like/it`."),
        ("/" + "x" * 64, "a name of 65 characters."),
        ("/v1/%00act", "a name of 8 characters; did you mean `/v1/act`?"),
    ],
)
async def test_a_path_that_there_is_not_is_named_beside_one_that_is_close(path: str, says: str) -> None:
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app()), base_url="http://toy") as opened:
        reply = await opened.post(path)
    assert reply.status_code == 404
    assert reply.json()["detail"].endswith(f"got {says}")
