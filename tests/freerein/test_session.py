"""A browser signs in once, and its cookie opens everything to the service's own page, and nothing to any other."""

from typing import Any

import httpx
import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from freerein.serving.health import Health
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.rest.app import make_app
from freerein.serving.rest.web_page import WebPage

TOKEN = "correct-horse-battery"
OWN, LISTED = "http://robot:8100", "http://robot:3000"
CALL = "/services/toy/v1/call"
FORM = {"content-type": "application/x-www-form-urlencoded"}
MULTIPART = {"content-type": "multipart/form-data; boundary=x"}


def client(
    *, token: str = TOKEN, base_url: str = OWN, origins: tuple[str, ...] = (), is_local: bool = False
) -> httpx.AsyncClient:
    """Returns a client of an app with a page that has one call, which answers 200."""

    async def answer(_request: Request) -> Response:
        return Response()

    page = WebPage([Route(CALL, answer, methods=["GET", "POST"]), Route("/web/{name}", answer)], assets="/web/")
    served: dict[str, Any] = {"health": Health(), "metrics": Metrics(), "limits": Limits(), "token": token}
    app = make_app("toy", [], **served, origins=origins, is_local=is_local, page=page)
    return httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=base_url)


async def signed_in(**options: Any) -> httpx.AsyncClient:
    http = client(**options)
    assert (await http.post("/session", json={"token": TOKEN})).status_code == 204
    return http


async def test_the_right_token_is_a_cookie_that_no_script_reads_until_it_is_taken_away() -> None:
    http = client()
    assert (await http.get("/session")).json() == {"token_needed": True, "signed_in": False}
    assert (await http.get(CALL)).status_code == 401
    reply = await http.post("/session", json={"token": TOKEN})
    assert (reply.status_code, reply.content) == (204, b"")
    cookie, *attributes = reply.headers["set-cookie"].lower().split("; ")
    assert set(attributes) == {"httponly", "samesite=strict", "path=/"}
    assert TOKEN not in cookie
    assert (await http.get("/session")).json() == {"token_needed": True, "signed_in": True}
    assert (await http.get(CALL)).status_code == 200
    assert (await http.delete("/session")).status_code == 204
    assert (await http.get(CALL)).status_code == 401


async def test_a_cookie_outlives_the_process_and_not_the_token() -> None:
    cookies = (await signed_in()).cookies
    for token, status in ((TOKEN, 200), ("another", 401)):
        assert (await client(token=token).get(CALL, headers={"cookie": dict_text(cookies)})).status_code == status


async def test_under_tls_the_cookie_is_sent_under_tls_alone() -> None:
    reply = await client(base_url="https://robot:8100").post("/session", json={"token": TOKEN})
    assert "secure" in reply.headers["set-cookie"].lower().split("; ")


@pytest.mark.parametrize(
    ("content", "media_type", "status", "code"),
    [
        (b'{"token": "wrong"}', "application/json", 401, "unauthenticated"),
        (b'{"token": ""}', "application/json", 401, "unauthenticated"),
        (b'{"token": 1}', "application/json", 422, "invalid_input"),
        (b"[]", "application/json", 422, "invalid_input"),
        (b'{"token": "x", "more": 1}', "application/json", 422, "invalid_input"),
        (b"{", "application/json", 400, "malformed_request"),
        (b"[" * 5000, "application/json", 413, "too_large"),
        (b"token=correct-horse-battery", "application/x-www-form-urlencoded", 415, "unsupported_media"),
        (b'{"token": "correct-horse-battery"}', "text/plain", 415, "unsupported_media"),
    ],
)
async def test_no_other_body_signs_in(content: bytes, media_type: str, status: int, code: str) -> None:
    reply = await client().post("/session", content=content, headers={"content-type": media_type})
    assert (reply.status_code, reply.json()["code"]) == (status, code)
    assert reply.json()["hint"]
    assert "set-cookie" not in reply.headers


async def test_without_a_token_there_is_nothing_to_sign_in_to() -> None:
    http = client(token="")
    assert (await http.get("/session")).json() == {"token_needed": False, "signed_in": True}
    assert (await http.post("/session", json={"token": "any"})).headers.get("set-cookie") is None
    assert (await http.get(CALL)).status_code == 200


@pytest.mark.parametrize("path", ["/web/app.js", "/session", "/docs", "/healthz"])
async def test_the_page_and_its_door_are_there_without_the_token(path: str) -> None:
    assert (await client().get(path)).status_code == 200


@pytest.mark.fault("C27")
@pytest.mark.parametrize(
    ("method", "headers"),
    [
        ("POST", {}),  # no Origin
        ("POST", FORM),
        ("POST", MULTIPART | {"origin": "http://elsewhere.example"}),
        ("POST", FORM | {"origin": "null"}),
        ("POST", {"origin": LISTED}),  # a port of the same host, which has the cookie sent
        ("POST", {"origin": "http://robot:8100.elsewhere.example"}),
        ("POST", {"origin": OWN, "sec-fetch-site": "cross-site"}),
        ("POST", {"origin": "http://rebound.example:8100"}),
        ("POST", {"sec-fetch-site": "same-origin"}),
        ("GET", {"origin": LISTED}),
        ("GET", {"sec-fetch-site": "same-site"}),
        ("GET", {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}),
        ("DELETE", {}),
    ],
)
async def test_a_call_with_the_cookie_that_is_not_of_the_own_page_is_refused(
    method: str, headers: dict[str, str]
) -> None:
    http = await signed_in(origins=(LISTED,))
    for path in (CALL, "/v1/start-run", "/metrics"):
        reply = await http.request(method, path, headers=headers)
        assert (reply.status_code, reply.json()["code"]) == (403, "permission_denied"), path


@pytest.mark.parametrize(
    ("method", "headers"),
    [
        ("POST", {"origin": OWN, "sec-fetch-site": "same-origin"}),
        ("POST", {"origin": OWN.upper()}),
        ("POST", {"origin": LISTED, "sec-fetch-site": "same-origin"}),  # its own page, behind a proxy
        ("GET", {}),
        ("GET", {"sec-fetch-site": "same-origin"}),
        ("GET", {"sec-fetch-site": "none", "sec-fetch-mode": "navigate"}),
    ],
)
async def test_a_call_of_the_own_page_is_answered(method: str, headers: dict[str, str]) -> None:
    assert (await (await signed_in(origins=(LISTED,))).request(method, CALL, headers=headers)).status_code == 200


async def test_a_page_that_an_operator_allows_calls_with_the_token() -> None:
    headers = {"origin": LISTED, "authorization": f"Bearer {TOKEN}"}
    assert (await client(origins=(LISTED,)).post(CALL, headers=headers)).status_code == 200
    wrong = {"authorization": "Bearer wrong"}  # beside a cookie, too
    assert (await (await signed_in()).get(CALL, headers=wrong)).status_code == 401


@pytest.mark.fault("C26")
@pytest.mark.parametrize(
    "headers",
    [
        {"host": "rebound.example:8100"},
        {"host": "rebound.example:8100", "origin": "http://rebound.example:8100"},
        {"origin": "http://localhost:3000"},
        FORM | {"origin": "http://elsewhere.example"},
        MULTIPART | {"origin": "null"},
    ],
)
async def test_without_a_token_no_other_page_comes_in_by_any_door(headers: dict[str, str]) -> None:
    http = client(token="", base_url="http://localhost:8100", is_local=True)
    for path in (CALL, "/session", "/web/app.js"):
        reply = await http.request("POST" if path != "/web/app.js" else "GET", path, headers=headers, content=b"")
        assert (reply.status_code, reply.json()["code"]) == (403, "permission_denied"), path


def dict_text(cookies: httpx.Cookies) -> str:
    """Returns cookies as the header of another host."""
    return "; ".join(f"{name}={value}" for name, value in cookies.items())
