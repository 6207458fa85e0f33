"""The page in Debian's chromium, in front of real services with the models that ship."""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
WEB = ROOT / "web"
SERVICES = ("segmentation", "imitation", "reward", "sim", "orchestrator")
PATIENCE_MS = 20_000
REBOUND = "rebound.example"
"""A name that the browser resolves to loopback, as that of a page that had its own name made to."""


def why_not_node() -> str:
    """Returns why the page cannot be built here; empty where it can."""
    if shutil.which("node") is None:
        return "Node is not installed: the page is neither built nor tested"
    return "" if (WEB / "node_modules").is_dir() else "web/node_modules is missing: run `npm ci` in web/"


@pytest.fixture(scope="session")
def node() -> str:
    """The path of Node, where the packages of `web/` are installed, too."""
    if reason := why_not_node():
        pytest.skip(reason)
    return str(shutil.which("node"))


class Stack:
    """All services, each of which may be killed and started again at its ports."""

    def __init__(self, start: Callable[..., Any], ports: dict[str, Any], data_dir: Path) -> None:
        self._start, self._ports, self.data_dir = start, ports, data_dir
        self.services = {name: self.start(name) for name in SERVICES}
        self.url = self.services["orchestrator"].url

    def start(self, name: str) -> Any:
        environ = {"FREEREIN_SHIPPED_DIR": str(ROOT / "models")}
        for each, ports in self._ports.items():
            environ[f"FREEREIN_{each.upper()}_ADDRESS"] = f"127.0.0.1:{ports.grpc}"
            environ[f"FREEREIN_{each.upper()}_URL"] = f"http://127.0.0.1:{ports.rest}"
        own = self._ports[name]
        environ |= {"FREEREIN_HTTP_PORT": str(own.rest), "FREEREIN_GRPC_PORT": str(own.grpc)}
        return self._start(f"freerein_{name}", self.data_dir, **environ)

    def kill(self, name: str) -> None:
        self.services[name].kill()
        self.services[name].process.wait(60)

    def restart(self, name: str) -> None:
        self.services[name] = self.start(name)
        self.services[name].until_ready()


@pytest.fixture(scope="module")
def stack(
    start_module_service: Callable[..., Any],
    reserve_ports: Callable[..., Any],
    tmp_path_factory: pytest.TempPathFactory,
) -> Stack:
    """The services of this module's tests, all ready."""
    stack = Stack(start_module_service, reserve_ports(SERVICES), tmp_path_factory.mktemp("data"))
    for service in stack.services.values():
        service.until_ready()
    return stack


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's chromium, driven by Playwright."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install --group dev")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("chromium is not installed: the page is not tested in a browser (apt-get install chromium)")
    arguments = [f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1"]
    arguments += ["--no-sandbox"] if os.geteuid() == 0 else []
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=arguments)
        yield browser
        browser.close()


@dataclass
class Watched:
    """A page, and what it did that a page should not.

    Attributes:
        page: Playwright's page.
        errors: What it wrote to the console as an error, and uncaught exceptions.
        elsewhere: URLs of requests to anything but the orchestrator.
    """

    page: Any
    errors: list[str]
    elsewhere: list[str]

    def open(self, path: str) -> Any:
        """Opens a state of the page; returns the page."""
        self.page.goto(self.page.base + path)
        return self.page


def watch(browser: Any, url: str, **options: Any) -> Watched:
    """Returns a page of its own context, without anything open."""
    page = browser.new_context(viewport={"width": 1280, "height": 900}, **options).new_page()
    page.base = url
    page.set_default_timeout(PATIENCE_MS)
    watched = Watched(page, [], [])
    page.on("pageerror", lambda error: watched.errors.append(str(error)))
    page.on("console", lambda line: watched.errors.append(line.text) if line.type == "error" else None)
    ours = (url, "blob:", "data:")
    page.on("request", lambda sent: None if sent.url.startswith(ours) else watched.elsewhere.append(sent.url))
    return watched


@pytest.fixture
def watched(browser: Any, stack: Stack) -> Iterator[Watched]:
    """A page that in the end must have written no error and asked nobody but the orchestrator."""
    watched = watch(browser, stack.url)
    yield watched
    watched.page.context.close()
    assert watched.errors == []
    assert watched.elsewhere == []


@pytest.fixture
def interrupted(browser: Any, stack: Stack) -> Iterator[Watched]:
    """A page that may write errors: services are killed while it is watched."""
    watched = watch(browser, stack.url)
    yield watched
    watched.page.context.close()
    assert watched.elsewhere == []
