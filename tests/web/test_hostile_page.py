"""A page on another port, in the browser of someone who is signed in: it starts, ends and reads nothing."""

import json
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any

import httpx
import pytest
from tests.web.conftest import REBOUND

pytestmark = [pytest.mark.e2e, pytest.mark.fault("C26"), pytest.mark.fault("C27")]

TOKEN = "correct-horse-battery"
DOORS = {
    "fetch": """async ({ url, posts, gets }) => {
        const types = ["application/json", "text/plain", "application/x-www-form-urlencoded"];
        const asked = gets.map((path) => [path, {}]);
        for (const [path, body] of posts) {
            for (const type of types) asked.push([path, { method: "POST", body, headers: { "content-type": type } }]);
            const form = new FormData();
            for (const [key, value] of Object.entries(JSON.parse(body))) form.append(key, JSON.stringify(value));
            asked.push([path, { method: "POST", body: form }]);
        }
        const modes = ["cors", "no-cors"].flatMap((mode) => [{ mode }, { mode, credentials: "include" }]);
        const read = (path, init) => fetch(url + path, init).then((reply) => reply.text()).catch(() => "");
        return Promise.all(asked.flatMap(([path, init]) => modes.map((mode) => read(path, { ...init, ...mode }))));
    }""",
    "form": """async ({ url, posts }) => {
        const types = ["text/plain", "multipart/form-data", "application/x-www-form-urlencoded"];
        const send = ([path, body], enctype) => new Promise((resolve) => {
            const frame = Object.assign(document.createElement("iframe"), { name: `${path} ${enctype}` });
            const form = Object.assign(document.createElement("form"), { method: "post", action: url + path, enctype });
            form.target = frame.name;
            for (const [name, value] of [...Object.entries(JSON.parse(body)), [body.slice(0, -1) + ', "x":"', '"}']])
                form.append(Object.assign(document.createElement("input"), { name, value }));
            document.body.append(frame, form);
            frame.onload = () => frame.src !== "about:blank" && resolve(frame.contentDocument?.body.innerText ?? "");
            form.submit();
        });
        return Promise.all(posts.flatMap((post) => types.map((type) => send(post, type))));
    }""",
    "frame": """({ url, gets }) => Promise.all(["/", ...gets].map((path) => new Promise((resolve) => {
        const frame = Object.assign(document.createElement("iframe"), { src: url + path });
        frame.onload = () => resolve(frame.contentDocument?.body.innerText ?? "");
        document.body.append(frame);
    })))""",
    "events": """({ url, events }) => Promise.all([false, true].map((withCredentials) => new Promise((resolve) => {
        const source = new EventSource(url + events, { withCredentials });
        source.onmessage = (event) => resolve(event.data);
        source.onerror = () => resolve("");
    })))""",
    "script": """({ url, gets }) => Promise.all(gets.flatMap((path) => ["script", "img"].map((kind) =>
        new Promise((resolve) => {
            const element = Object.assign(document.createElement(kind), { src: url + path });
            element.onload = () => resolve(`${kind} ${path}`);
            element.onerror = () => resolve("");
            document.body.append(element);
        }))))""",
}
"""What a page may try, each a function that returns what it could read."""


class _Blank(BaseHTTPRequestHandler):
    """Answers with a page that has nothing on it."""

    def do_GET(self) -> None:
        content = b"<!doctype html><title>Elsewhere</title><body></body>"
        self.send_response(200)
        self.send_header("content-type", "text/html")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def elsewhere() -> Iterator[str]:
    """URL of a page on another port of this host, which has the session's cookie sent."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _Blank) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.mark.parametrize("token", ["", TOKEN], ids=["without a token", "with a token"])
def test_a_page_on_another_port_starts_ends_and_reads_nothing(
    browser: Any, start_service: Callable[..., Any], elsewhere: str, token: str
) -> None:
    service = start_service("freerein_orchestrator", **({"FREEREIN_TOKEN": token} if token else {})).until_ready()
    headers = {"authorization": f"Bearer {token}"} if token else {}
    with httpx.Client(base_url=service.url, headers=headers, timeout=60) as own:
        wanted: dict[str, object] = {"kind": "collect", "config": {"task": "grid", "dataset": "demos", "count": 1}}
        run = own.post("/v1/start-run", json=wanted).json()["run"]["id"]  # waits: there is no sim service
        posts: dict[str, dict[str, object]] = {
            "/v1/start-run": wanted,
            "/v1/cancel-run": {"id": run},
            "/services/segmentation/v1/start-fit": {"dataset": "demos"},
        }
        tried = {
            "url": service.url,
            "posts": [[path, json.dumps(body)] for path, body in posts.items()],
            "gets": ["/v1/list-runs", f"/v1/get-run?id={run}", "/session", "/metrics", "/services/sim/v1/list-tasks"],
            "events": f"/v1/watch-run?id={run}",
        }
        context = browser.new_context()
        page = context.new_page()
        if token:
            page.goto(service.url)
            page.get_by_label("Token").fill(token)
            page.get_by_role("button", name="Sign in").click()
            page.get_by_role("slider", name="Time").wait_for()
        page.goto(elsewhere)
        statuses = set[int]()
        page.on("response", lambda reply: statuses.add(reply.status) if reply.url.startswith(service.url) else None)
        for door, attack in DOORS.items():
            assert {*page.evaluate(attack, tried)} == {""}, door
        assert statuses == ({401, 403} if token else {403})
        answered = page.goto(f"http://{REBOUND}:{service.http_port}/v1/list-runs")
        assert answered.status == (401 if token else 403)
        listed = own.get("/v1/list-runs").json()["runs"]
        assert [(each["id"], each["state"] in ("queued", "running")) for each in listed] == [(run, True)]
        context.close()
