"""The files of the web page: their headers, how long they are kept, and that no other file is served."""

import gzip
from collections.abc import Callable
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx
import pytest

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.rest.web_page import WebPage
from freerein_orchestrator.web.page import ASSETS, NOT_BUILT, page_routes

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
FILES = {
    "index.html": (b"<!doctype html>", "text/html; charset=utf-8"),
    "app-1a2b.js": (b"export{};" * 200, "text/javascript; charset=utf-8"),
    "app-3c4d.css": (b"a{}", "text/css; charset=utf-8"),
    "icon-5e6f.svg": (b"<svg/>", "image/svg+xml"),
    "demonstration-7a8b.json": (b"{}", "application/json"),
    "demonstration-9c0d.webp": (b"RIFF", "image/webp"),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "page").mkdir()
    for name, (content, _) in FILES.items():
        (tmp_path / "page" / name).write_bytes(content)
    (tmp_path / "page" / "secret.pem").write_bytes(b"")
    (tmp_path / "outside.json").write_bytes(b"")
    return tmp_path / "page"


def client(folder: Path) -> httpx.AsyncClient:
    served: dict[str, Any] = {"health": Health(), "metrics": Metrics(), "limits": Limits(), "token": "secret"}
    app = make_app("orchestrator", [], **served, page=WebPage(page_routes(folder), assets=ASSETS))
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost:8100")


@pytest.mark.parametrize("name", FILES)
async def test_a_file_of_the_page_comes_with_its_type_and_a_policy(folder: Path, name: str) -> None:
    content, media_type = FILES[name]
    reply = await client(folder).get("/" if name == "index.html" else f"/web/{name}")
    assert (reply.status_code, reply.content, reply.headers["content-type"]) == (200, content, media_type)
    assert reply.headers["content-security-policy"] == POLICY
    assert reply.headers["x-content-type-options"] == "nosniff"
    assert reply.headers["referrer-policy"] == "no-referrer"
    assert reply.headers["cross-origin-opener-policy"] == "same-origin"
    kept = "no-cache" if name == "index.html" else "public, max-age=31536000, immutable"
    assert reply.headers["cache-control"] == kept


async def test_text_is_compressed_where_that_is_asked_for(folder: Path) -> None:
    http = client(folder)
    async with http.stream("GET", "/web/app-1a2b.js", headers={"accept-encoding": "gzip"}) as reply:
        raw = b"".join([part async for part in reply.aiter_raw()])
    assert reply.headers["content-encoding"] == "gzip"
    assert reply.headers["vary"] == "Accept-Encoding"
    assert gzip.decompress(raw) == FILES["app-1a2b.js"][0]
    assert len(raw) < 100


@pytest.mark.parametrize("name", ["other.js", "secret.pem", "..%2foutside.json", "%2e%2e%2foutside.json", ""])
async def test_what_is_no_file_of_the_page_is_not_found(folder: Path, name: str) -> None:
    reply = await client(folder).get(f"/web/{name}")
    assert (reply.status_code, reply.json()["code"]) == (404, "not_found")


@pytest.mark.fault("C15")
def test_no_path_leads_out_of_the_folder_of_a_process(start_service: Callable[..., Any]) -> None:
    connection = HTTPConnection("127.0.0.1", start_service("freerein_orchestrator").http_port, timeout=60)
    for path in ("/web/../__main__.py", "/web/%2e%2e/__main__.py", "/web//etc/passwd", "/web/..%2f..%2fpyproject.toml"):
        connection.request("GET", path)
        reply = connection.getresponse()
        assert (reply.status, b"import" in reply.read()) == (404, False), path
    connection.close()


async def test_a_page_that_is_not_built_says_how_to_build_it(tmp_path: Path) -> None:
    reply = await client(tmp_path).get("/")
    assert (reply.status_code, reply.text) == (404, NOT_BUILT)
    assert (await client(tmp_path).get("/docs")).status_code == 200


async def test_the_page_of_calls_cannot_be_framed_by_another(folder: Path) -> None:
    assert (await client(folder).get("/docs")).headers["content-security-policy"] == "frame-ancestors 'none'"
