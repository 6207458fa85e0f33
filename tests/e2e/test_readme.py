"""The code blocks of the README and of pages of `docs/`, run in order as a newcomer would."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

CLONE = Path(__file__).parents[2]
PAGES = (CLONE / "README.md", CLONE / "docs" / "training-loop.md")
BLOCKS = [
    block
    for page in PAGES
    for block in re.findall(r"^```(sh|python)\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
]
SERVICES = tuple(f"http://127.0.0.1:{port}" for port in (8100, 8101, 8102, 8103, 8104))

pytestmark = [pytest.mark.e2e, pytest.mark.xdist_group("default-ports")]


@pytest.fixture
def newcomer(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a newcomer's shell, with the services of the first block running in another terminal."""
    environ = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "FREEREIN_DATA_DIR": "var"}
    (tmp_path / "examples").symlink_to(CLONE / "examples")
    services = subprocess.Popen(["freerein", "up"], cwd=tmp_path, env=environ)
    try:
        deadline = time.monotonic() + 300
        while not all(_is_ready(url) for url in SERVICES):
            assert services.poll() is None, "freerein up ended"
            assert time.monotonic() < deadline, "the services were not ready within five minutes"
            time.sleep(0.2)  # a poll in a closed loop would slow down the start that it waits for
        yield environ
        services.send_signal(signal.SIGINT)
        assert services.wait(60) == 0
    finally:
        services.kill()


@pytest.mark.fault("G13")
def test_the_readme_is_true(newcomer: dict[str, str], tmp_path: Path) -> None:
    assert BLOCKS[0] == ("sh", "freerein up\n")
    for language, block in BLOCKS[1:]:
        block = re.sub(r"steps=[0-9_]+", "steps=40", block)  # noqa: PLW2901  # what is learned, `make demo` shows
        command = ["bash", "-euo", "pipefail", "-c", block] if language == "sh" else [sys.executable, "-c", block]
        ran = subprocess.run(command, cwd=tmp_path, env=newcomer, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, f"{block}\n{ran.stdout}\n{ran.stderr}"


def _is_ready(url: str) -> bool:
    try:
        return httpx.get(f"{url}/readyz", timeout=10).is_success
    except httpx.HTTPError:
        return False
