"""The code blocks of the README and of pages of `docs/`, run in order as a newcomer would."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from freerein.ports import PORTS

CLONE = Path(__file__).parents[2]
PAGES = (CLONE / "README.md", CLONE / "docs" / "use.md", CLONE / "docs" / "training-loop.md")
BLOCKS = [
    block
    for page in PAGES
    for block in re.findall(r"^```(sh|python)\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
]
FEWER = (  # what is learned, `make demo` shows
    (r"\bsteps=[0-9_]+", "steps=10"),
    (r"--count 100\b", "--count 20"),
    (r"n_steps=16, batch_size=64", "n_steps=2, batch_size=16"),
    (r"learn\(128\)", "learn(16)"),
)
Newcomer = dict[str, list[str | Path]]
"""How a newcomer's shell starts a block of a language."""

pytestmark = [pytest.mark.e2e, pytest.mark.xdist_group("default-ports")]


@pytest.fixture
def typed(tmp_path: Path) -> Iterator[Newcomer]:
    """With the services of the first block running in another terminal."""
    (tmp_path / "examples").symlink_to(CLONE / "examples")
    services = subprocess.Popen(["freerein", "up"], cwd=tmp_path)
    try:
        deadline = time.monotonic() + 300
        while not all(_is_ready(f"http://127.0.0.1:{ports.rest}") for ports in PORTS.values()):
            assert services.poll() is None, "freerein up ended"
            assert time.monotonic() < deadline, "the services were not ready within five minutes"
            time.sleep(0.2)  # a poll in a closed loop would slow down the start that it waits for
        yield {"sh": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"]}
        services.send_signal(signal.SIGINT)
        assert services.wait(60) == 0
    finally:
        services.kill()


@pytest.fixture
def forked(
    tmp_path: Path,
    commands: Path,
    start_service: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> Newcomer:
    """With services, commands and programs that are forked."""
    monkeypatch.setenv("PATH", f"{commands}:{os.environ['PATH']}")
    for name, ports in PORTS.items():
        at = {"FREEREIN_HTTP_PORT": str(ports.rest), "FREEREIN_GRPC_PORT": str(ports.grpc)}
        start_service(f"freerein_{name}", tmp_path / "var", **at).until_ready()
    return {"sh": ["bash", "-euo", "pipefail", "-c"], "python": [commands / "freerein-python"]}


@pytest.mark.fault("G13")
@pytest.mark.parametrize("how", ["forked", pytest.param("typed", marks=pytest.mark.long)])
def test_the_readme_is_true(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.setenv("FREEREIN_DATA_DIR", "var")
    starts: Newcomer = request.getfixturevalue(how)
    assert BLOCKS[0] == ("sh", "freerein up\n")
    for language, block in BLOCKS[1:]:
        for many, few in FEWER:
            block = re.sub(many, few, block)  # noqa: PLW2901
        ran = subprocess.run([*starts[language], block], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"{block}\n{ran.stdout}\n{ran.stderr}"


def _is_ready(url: str) -> bool:
    try:
        return httpx.get(f"{url}/readyz", timeout=10, trust_env=False).is_success
    except httpx.HTTPError:
        return False
